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

from magical_mj import constants as c
from magical_mj.actions import ACTIONS, to_discrete
from magical_mj.env_settings import Reward
from magical_mj.environment import Environment, load
from magical_mj.errors import InvalidSceneError, unknown_name
from magical_mj.frames import FrameStack, Images
from magical_mj.observations import STATE_NAMES
from magical_mj.presets import Preset, preset
from magical_mj.rendering.renderer import check_size
from magical_mj.scene import Scene
from magical_mj.state import State
from magical_mj.tasks.spec import Rules
from magical_mj.wrappers import CONTINUOUS_SPACE

ActionForm = Literal["discrete", "continuous"]
ACTION_FORMS: Final[tuple[str, ...]] = get_args(ActionForm)
Observation = NDArray[Any] | dict[str, Images]

RENDER_SIZE: Final = 384  # px, side of what `render` gives
STATE_BOUND: Final = 1000.0  # of any entry of the state vector; angles add up to 100 rad in the longest episode


class MagicalEnv(gymnasium.Env[Observation, Any]):
    """One of the 60 environments; make it with `gymnasium.make("magical_mj/...")`.

    ## Actions
    `Discrete(18)`: 9 * gripper + 3 * turn + drive; see `magical_mj.actions`. One action lasts 1/8 s. With
    `action="continuous"`, vectors (drive, turn, grip) in [-1, 1]; see `magical_mj.wrappers.ContinuousActions`.

    ## Observations
    What the preset says (`magical_mj.presets.PRESETS`): uint8 pictures stacked along the channels, oldest
    first, or the state vector. After a reset the first frame fills the stack.

    ## Episodes
    `reset(seed=7)` starts in `sample_scene(task, variant, 7)`; `reset()` in a scene drawn by `np_random`;
    `reset(options={"scene": scene})` in that `Scene` or its JSON; `reset(options={"state": state})` goes on from
    what `get_state()` gave. An episode is truncated at the task's horizon and never terminates. The reward is 0:
    `info["eval_score"]` is the score in [0, 1] at the last step (0.0 before), `info["is_success"]` whether it is 1.

    Args:
        task: one of `magical_mj.TASKS`.
        variant: one of `magical_mj.VARIANTS`.
        preset: one of `magical_mj.presets.PRESETS`.
        image_size: side of the pictures in pixels, instead of the preset's.
        reward: "none", or "score" for the score as reward at the last step.
        rules: "paper" or "released".
        action: "discrete" or "continuous".
        render_mode: "rgb_array" (the allo view, 384 px); Gymnasium makes "human" (a window) from it.
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
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise unknown_name("render mode", render_mode, self.metadata["render_modes"])
        if action not in ACTION_FORMS:
            raise unknown_name("form of actions", action, ACTION_FORMS)
        self.render_mode = render_mode
        self._preset = _preset(preset)
        size = self._preset.image_size if image_size is None else check_size(image_size)
        self._env = load(
            task,
            variant,
            seed=0,
            observations=["state"] if self._preset.layout == "state" else [],  # pictures are drawn into the stacks
            image_size=size,
            reward=reward,
            rules=rules,
        )
        self._continuous = action == "continuous"
        self.action_space = CONTINUOUS_SPACE if self._continuous else spaces.Discrete(len(ACTIONS))
        self._stacks = _stacks(self._preset, size)
        self.observation_space = _space(self._preset, self._stacks)
        self._begun = self._running = False

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

        Raises:
            InvalidSceneError: if `options` has unknown keys, or the scene is not one of the task.
            StateError: if the state is none of an episode of the task that goes on.
        """
        super().reset(seed=seed)
        scene, state = _scene_option(options or {}), (options or {}).get("state")
        if state is not None:
            first = self._env.reset(state=state)
        elif scene is not None:
            first = self._env.reset(scene=scene)
        else:
            first = self._env.reset(seed=int(self.np_random.integers(2**63)) if seed is None else seed)
        self._begun = self._running = True
        stacks = self._start_stacks({} if state is None else state.frames)
        return self._observation(first.observation, stacks), {"eval_score": 0.0, "is_success": False}

    def get_state(self) -> State:
        """The present state of the episode, to the bit, the pictures in the stacks included.

        Raises:
            gymnasium.error.ResetNeeded: before the first reset.
        """
        if not self._begun:
            raise ResetNeeded("no episode has begun; call reset() before get_state()")
        frames = {name: stack.last.copy() for name, stack in self._stacks.items()}
        return dataclasses.replace(self._env.get_state(), frames=frames)

    def set_state(self, state: State) -> None:
        """Goes back to a state, of this environment or another with the same task: what follows is the same to the bit.

        Where the state's pictures are not those of this environment's preset, the present ones fill the stacks. To see
        the observation at once, use `reset(options={"state": state})`.

        Raises:
            StateError: if it is no state of a scene of this task.
            InvalidSceneError: if its scene is not one of this task.
        """
        self._env.set_state(state)
        self._begun = True
        self._running = self._env.horizon is None or state.steps < self._env.horizon
        self._start_stacks(state.frames)

    def clone(self) -> MagicalEnv:
        """Another environment like this one, in the same state; both go on alike, later episodes included."""
        return copy.deepcopy(self)

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One action. Truncated at the horizon.

        Raises:
            InvalidActionError: if the action is not one of the 18.
            gymnasium.error.ResetNeeded: before the first reset and after the last step.
        """
        if not self._running:
            raise ResetNeeded("the episode has ended; call reset() before the next step")
        now = self._env.step(to_discrete(action) if self._continuous else action)
        stacks = {name: stack.push(self._see) for name, stack in self._stacks.items()}
        last = now.last()
        self._running = not last
        score = self._env.score() if last else 0.0
        info = {"eval_score": score, "is_success": score == 1.0}
        return self._observation(now.observation, stacks), float(now.reward or 0.0), False, last, info

    def render(self) -> Images | None:
        """The allo view, shape (384, 384, 3), if `render_mode` is "rgb_array"."""
        if self.render_mode is None:
            gymnasium.logger.warn('render() draws nothing: make the environment with render_mode="rgb_array"')
            return None
        return self._env.render("allo", RENDER_SIZE)

    def close(self) -> None:
        """Frees the simulation; closing twice is fine."""
        self._env.close()
        super().close()

    def _start_stacks(self, frames: Mapping[str, Images]) -> dict[str, Images]:
        """Fills the stacks with these frames if they fit, else with the present pictures."""
        fit = {name: array.shape for name, array in frames.items()} == {n: s.shape for n, s in self._stacks.items()}
        for name, stack in self._stacks.items():
            if fit:
                stack.last = frames[name].copy()
            else:
                stack.start(self._see)
        return {name: stack.last for name, stack in self._stacks.items()}

    def _see(self, view: str, place: Images) -> None:
        self._env.render(view, len(place), out=place)

    def _observation(self, seen: Mapping[str, NDArray[Any]], stacks: dict[str, Images]) -> Observation:
        if self._preset.layout == "state":
            return seen["state"]
        return stacks if self._preset.layout == "dict" else stacks["all"]


_preset = preset  # the constructor's argument of this name hides the function


def _stacks(made: Preset, size: int) -> dict[str, FrameStack]:
    """By view for the layout "dict"; else one of all views, under the name "all"."""
    if made.layout == "state":
        return {}
    if made.layout == "dict":
        return {view: FrameStack(((view, count),), size) for view, count in made.frames}
    return {"all": FrameStack(made.frames, size, channels_first=made.layout == "chw")}


def _space(made: Preset, stacks: Mapping[str, FrameStack]) -> spaces.Space[Any]:
    if made.layout == "state":
        return spaces.Box(-STATE_BOUND, STATE_BOUND, (len(STATE_NAMES),), np.float32)
    boxes: dict[str, spaces.Space[Any]] = {
        name: spaces.Box(0, 255, stack.shape, np.uint8) for name, stack in stacks.items()
    }
    return spaces.Dict(boxes) if made.layout == "dict" else boxes["all"]


def _scene_option(options: Mapping[str, Any]) -> Scene | None:
    unknown = options.keys() - {"scene", "state"}
    if unknown:
        raise InvalidSceneError(f'unknown options {sorted(unknown)}; reset understands options={{"scene": ...}}')
    scene = options.get("scene")
    if scene is None or isinstance(scene, Scene):
        return scene
    if isinstance(scene, str | bytes):
        return Scene.from_json(scene)
    raise InvalidSceneError(f'options["scene"] must be a Scene or its JSON, not {type(scene).__name__}')
