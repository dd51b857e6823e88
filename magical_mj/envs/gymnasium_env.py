"""The Gymnasium environment: presets of stacked frames over the dm_env environment."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping
from typing import Any, Final, Literal, get_args

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from magical_mj.envs.composer import Environment, State, load
from magical_mj.envs.frames import Images, Stacks
from magical_mj.envs.presets import observation_space, preset_named
from magical_mj.envs.reset_options import ResetOptions
from magical_mj.envs.wrappers import continuous_space
from magical_mj.rendering.renderer import check_size
from magical_mj.scene import Scene
from magical_mj.scene import constants as c
from magical_mj.scene.actions import ACTIONS, to_discrete
from magical_mj.scene.state_vector import CAMERAS, VIEWS
from magical_mj.tasks.spec import Reward, Rules
from magical_mj.utils.errors import InvalidSceneError, check_name
from magical_mj.variants import check_seed

ActionForm = Literal["discrete", "continuous"]
ACTION_FORMS: Final[tuple[str, ...]] = get_args(ActionForm)
Observation = NDArray[Any] | dict[str, NDArray[Any]]

RENDER_VIEWS: Final = (*CAMERAS, "both")


class MagicalEnv(gymnasium.Env[Observation, Any]):
    """One of the benchmark's environments; make it with `gymnasium.make("magical_mj/...")`.

    ## Actions
    `Discrete(18)`: 9 * gripper + 3 * turn + drive; see `magical_mj.scene.actions`. One action lasts 1/8 s. With
    `action="continuous"`, vectors (drive, turn, grip) in [-1, 1]; see `magical_mj.envs.wrappers.ContinuousActions`.

    ## Observations
    What the preset says (`magical_mj.envs.presets.PRESETS`): uint8 pictures stacked along the channels, oldest
    first, the state vector, or pictures and the fingers' angles. After a reset the first frame fills the stack.

    ## Episodes
    `reset(seed=7)` starts in `sample_scene(task, variant, 7)`; `reset()` in a scene drawn by `np_random`;
    `reset(options={"scene": scene})` in that `Scene` or its JSON; `reset(options={"state": state})` continues from
    a result of `get_state()`. An episode is truncated at the task's horizon and never terminates. The reward is 0:
    `info["eval_score"]` is the score in [0, 1] at the last step (0.0 before), `info["is_success"]` whether it is 1.

    Args:
        task: one of `magical_mj.TASKS`.
        variant: one of `magical_mj.VARIANTS`.
        preset: one of `magical_mj.envs.presets.PRESETS`.
        image_size: side of the pictures in pixels, instead of the preset's.
        reward: "none", or "score" for the score as reward at the last step.
        rules: "paper" or "released".
        action: "discrete" or "continuous".
        render_mode: "rgb_array"; Gymnasium makes "human" (a window) from it.
        render_view: the view of `render`: "ego", "allo", "both" side by side, or "scene", in 3-D from above a corner.
        render_size: side of each view in pixels.
        score_every_step: adds `info["score"]` at every step and reset: the score if the episode ended now. This takes
            up to a tenth of a step's time.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": c.CONTROL_RATE}  # noqa: RUF012

    def __init__(
        self,
        task: str,
        variant: str = "Demo",
        preset: str = "",
        *,
        image_size: int | None = None,
        reward: Reward = "none",
        rules: Rules = "paper",
        action: ActionForm = "discrete",
        render_mode: str | None = None,
        render_view: str = "allo",
        render_size: int = 384,
        score_every_step: bool = False,
    ) -> None:
        if render_mode is not None:
            check_name("render mode", render_mode, self.metadata["render_modes"])
        check_name("form of actions", action, ACTION_FORMS)
        check_name("view", render_view, RENDER_VIEWS)
        self.render_mode = render_mode
        self._views = VIEWS if render_view == "both" else (render_view,)
        self._render_size = check_size(render_size, "render_size")
        self._preset = preset_named(preset)
        size = self._preset.image_size if image_size is None else check_size(image_size)
        self._stacks = Stacks(self._preset, size)
        self._env = load(
            task,
            variant,
            seed=0,  # for an episode that is never played, since every reset gives a seed
            observations=["state"] if self._preset.layout == "state" else [],  # pictures go to the stacks
            image_size=size,
            reward=reward,
            rules=rules,
        )
        self._continuous = action == "continuous"
        self.action_space = continuous_space() if self._continuous else spaces.Discrete(len(ACTIONS))
        self.observation_space = observation_space(self._preset, self._stacks.shapes)
        self._score_every_step = score_every_step
        self._begun = False
        self._seeded: int | None = None
        self._options = ResetOptions("scene", "state")

    @property
    def dm_env(self) -> Environment:
        """The dm_env environment that this one runs."""
        return self._env

    @property
    def scene(self) -> Scene:
        """Where everything is now, fingers included."""
        return self._env.scene

    @property
    def initial_scene(self) -> Scene:
        """The scene in which this episode started."""
        return self._env.initial_scene

    def score(self) -> float:
        """The score in [0, 1] if the episode ended now."""
        return self._env.score()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode; see the class.

        Args:
            seed: of this episode's scene, and of `np_random`, which draws the seeds of later ones. If no step follows,
                the next reset without a seed starts in the same scene: the `set_seed` of some libraries resets once.
            options: "scene" or "state"; others are ignored, with a warning.

        Raises:
            InvalidSeedError: if the seed is not an integer, or negative.
            InvalidSceneError: if the scene is not one of the task.
            StateError: if the state is none of an episode of the task that goes on.
            SettingsError: if the options are no dict.
        """
        seed = None if seed is None else check_seed(seed)
        given = self._options.checked(options)
        scene, state = _scene_option(given), given.get("state")
        if scene is not None or state is not None:
            first = self._env.reset(scene=scene, state=state)
        else:
            again = self._seeded if seed is None else seed
            first = self._env.reset(seed=int(self.np_random.integers(2**63)) if again is None else again)
        super().reset(seed=seed)  # last, so that a reset that is refused leaves the generator as it was
        self._begun = True
        self._seeded = seed if scene is None and state is None else None
        stacks = self._stacks.start(self._see, None if state is None else state.frames)
        return self._observation(first.observation, stacks), self._info(last=False)

    def get_state(self) -> State:
        """The present state of the episode, to the bit, the pictures in the stacks included.

        Raises:
            gymnasium.error.ResetNeeded: before the first reset.
        """
        if not self._begun:
            raise ResetNeeded("no episode has begun; call reset() before get_state()")
        return dataclasses.replace(self._env.get_state(), frames=self._stacks.save())

    def set_state(self, state: State) -> None:
        """Goes back to a state, of this environment or another with the same task: what follows is the same to the bit.

        Where the state's pictures are not those of this environment's preset, the present ones fill the stacks. To see
        the observation at once, use `reset(options={"state": state})`.

        Raises:
            StateError: if it is no state of a scene of this task.
            InvalidSceneError: if its scene is not one of this task.
        """
        self._env.set_state(state)
        self._begun, self._seeded = True, None
        self._stacks.start(self._see, state.frames)

    def __getstate__(self) -> dict[str, Any]:
        """For copying and pickling: with the generator of later scenes, which Gymnasium makes when it is first used."""
        _ = self.np_random
        return self.__dict__

    def clone(self) -> MagicalEnv:
        """Another environment like this one, in the same state; both go on alike, later episodes included."""
        return copy.deepcopy(self)

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One action. Truncated at the horizon.

        Raises:
            InvalidActionError: if the action is not one of the 18.
            gymnasium.error.ResetNeeded: before the first reset and after the last step.
        """
        if not self._begun or self._env.over:
            raise ResetNeeded("the episode has ended; call reset() before the next step")
        now = self._env.step(to_discrete(action) if self._continuous else action)
        last, self._seeded = now.last(), None
        observation = self._observation(now.observation, self._stacks.push(self._see))
        return observation, float(now.reward or 0.0), False, last, self._info(last=last)

    def render(self) -> Images | None:
        """The view of `render_view` if `render_mode` is "rgb_array". Shape (size, size, 3); "both": twice as wide."""
        if self.render_mode is None:
            gymnasium.logger.warn('render() draws nothing: make the environment with render_mode="rgb_array"')
            return None
        return np.concatenate([self._env.render(view, self._render_size) for view in self._views], axis=1)

    def close(self) -> None:
        """Frees the simulation; closing twice is fine."""
        self._env.close()
        super().close()

    def _info(self, *, last: bool) -> dict[str, Any]:
        """The same keys always. TorchRL reads the `dtype` of each value; vectors would lose that of a `numpy.bool`."""
        score = self.score() if last or self._score_every_step else 0.0
        reached = score if last else 0.0
        info = {"eval_score": np.float64(reached), "is_success": np.array(reached == 1.0)}
        return info | {"score": np.float64(score)} if self._score_every_step else info

    def _see(self, view: str, place: Images) -> None:
        self._env.render(view, len(place), out=place)

    def _observation(self, seen: Mapping[str, NDArray[Any]], stacks: dict[str, Images]) -> Observation:
        if self._preset.layout == "state":
            return seen["state"]
        if self._preset.fingers:
            fingers = self._env.task.world.fingers(self._env.physics.data.qpos)
            return {**stacks, "fingers": fingers.astype(np.float32)}
        return stacks if self._preset.layout == "dict" else next(iter(stacks.values()))


def _scene_option(options: Mapping[str, Any]) -> Scene | None:
    scene = options.get("scene")
    if scene is None or isinstance(scene, Scene):
        return scene
    if isinstance(scene, str | bytes):
        return Scene.from_json(scene)
    raise InvalidSceneError(f'options["scene"] must be a Scene or its JSON, not {type(scene).__name__}')
