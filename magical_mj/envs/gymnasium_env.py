"""The Gymnasium environment: presets of stacked frames over the engine."""

from __future__ import annotations

import copy
import dataclasses
import warnings
from collections.abc import Mapping
from functools import cached_property
from typing import Any, Final, Literal, get_args

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from magical_mj.engine import Engine, State
from magical_mj.engine.engine import check_goes_on
from magical_mj.engine.simulation import check_state
from magical_mj.envs.presets import Images, Preset, Stacks, observation_space, preset_named
from magical_mj.envs.variation import MAX_SEED, Variation, VariationSpace
from magical_mj.envs.wrappers import check_limit, continuous_space
from magical_mj.rendering.renderer import check_size
from magical_mj.scene import Scene
from magical_mj.scene import constants as c
from magical_mj.scene.actions import ACTIONS, to_discrete
from magical_mj.scene.bodies import GRIPPER
from magical_mj.scene.state_vector import CAMERAS, VIEWS, StateEncoder
from magical_mj.shifts.episode import Draws
from magical_mj.shifts.registry import Shifts
from magical_mj.tasks.registry import TASKS
from magical_mj.tasks.spec import REWARDS, Reward, Rules
from magical_mj.utils.errors import InvalidSceneError, SettingsError, check_name, short_repr
from magical_mj.variants import check_seed

ActionForm = Literal["discrete", "continuous"]
ACTION_FORMS: Final[tuple[str, ...]] = get_args(ActionForm)
Observation = NDArray[Any] | dict[str, NDArray[Any]]

CUTS: Final = 3
"""After how many episodes that were reset at the same late step a warning says that they have reported no score."""
RENDER_VIEWS: Final = (*CAMERAS, "both")
STARTS: Final = ("scene", "state", "variation")
"""The options of `reset` that say how an episode starts."""


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
        renderer: "opengl" or "software" for flat views; None: MAGICAL_MJ_RENDERER, or what works (docs/pictures.md).
        shifts: shifts and their strengths, such as "camera:3,latency:1" or a dict; see docs/shifts.md.
        body: the robot's body, one that the task offers; see docs/bodies.md.
        instruction: adds the sentence that says what is to be done, which `instruction` is, too: `info["instruction"]`,
            and "instruction" in observations that are dicts. Shifts that change it add it to infos.
        render_mode: "rgb_array"; Gymnasium makes "human" (a window) from it.
        render_view: the view of `render`: "ego", "allo", "both" side by side, or "scene", in 3-D from above a corner.
        render_size: side of each view in pixels.
        score_every_step: adds `info["score"]` at every step and reset: the score if the episode ended now. This takes
            up to a tenth of a step's time.
        limit: the number of steps after which episodes end before the task's horizon.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": c.CONTROL_RATE}  # noqa: RUF012

    def __init__(
        self,
        task: str,
        variant: str = "Demo",
        preset: str | Preset = "",
        *,
        image_size: int | None = None,
        reward: Reward = "none",
        rules: Rules = "paper",
        action: ActionForm = "discrete",
        renderer: str | None = None,
        shifts: Shifts = None,
        instruction: bool = False,
        body: str = GRIPPER,
        render_mode: str | None = None,
        render_view: str = "allo",
        render_size: int = 384,
        score_every_step: bool = False,
        limit: int | None = None,
    ) -> None:
        if render_mode is not None:
            check_name("render mode", render_mode, self.metadata["render_modes"])
        check_name("form of actions", action, ACTION_FORMS)
        check_name("view", render_view, RENDER_VIEWS)
        self.render_mode = render_mode
        self._views = VIEWS if render_view == "both" else (render_view,)
        self._render_size = check_size(render_size, "render_size")
        self._preset = preset if isinstance(preset, Preset) else preset_named(preset)
        size = self._preset.image_size if image_size is None else check_size(image_size)
        self._stacks = Stacks(self._preset, size)
        check_name("reward", reward, REWARDS)
        self.reward: Reward = reward
        self._engine = Engine(task, variant, seed=0, rules=rules, renderer=renderer, shifts=shifts, body=body)
        self._limit = self._engine.setup.horizon or 0
        if limit is not None:
            self.limit = limit
        self._continuous = action == "continuous"
        self.action_space = continuous_space() if self._continuous else spaces.Discrete(len(ACTIONS))
        self._instruction = instruction
        self.observation_space = observation_space(self._preset, self._stacks.shapes, instruction=instruction)
        self._score_every_step = score_every_step
        self._begun = False
        self._cut = 0, 0  # the step at which the last episodes were reset before their end, and how many of them
        self._fresh_seed: int | None = None  # of the last reset, while no step has followed

    @property
    def engine(self) -> Engine:
        """The engine that this environment runs."""
        return self._engine

    @property
    def scene(self) -> Scene:
        """Where everything is now, fingers included."""
        return self._engine.scene

    @property
    def initial_scene(self) -> Scene:
        """The scene in which this episode started."""
        return self._engine.initial_scene

    @property
    def instruction(self) -> str:
        """The sentence that says what is to be done in this episode, as its shifts make it."""
        return self._engine.instruction

    @property
    def limit(self) -> int:
        """The number of steps of an episode since its start, also where it goes on from a state."""
        return self._limit

    @limit.setter
    def limit(self, steps: int) -> None:
        self._limit = check_limit(steps, self._engine.setup)

    @cached_property
    def variation_space(self) -> VariationSpace:
        """Every factor of scenes and shifts, with the default; see `magical_mj.envs.variation` and docs/shifts.md."""
        return VariationSpace(self._engine)

    @property
    def variation(self) -> Variation:
        """The values in `variation_space` of the present episode, which `reset` repeats with its option "variation"."""
        engine = self._engine
        seeds = {int(values["seed"]) for values in engine.draws.values()} or {engine.seed or 0}
        return self.variation_space.values_of(engine.initial_scene, engine.draws, min(seeds))

    def score(self) -> float:
        """The score in [0, 1] if the episode ended now."""
        return self._engine.score()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode; see the class.

        Args:
            seed: of this episode's scene, and of `np_random`, which draws the seeds of later ones. If no step follows,
                the next reset without a seed starts in the same scene: the `set_seed` of some libraries resets once.
            options: "scene" or "state"; or "variation": a dict of values in `variation_space`, whole or in part (what
                it lacks is as in the episode of the seed), or a list of names of factors to draw. Others are ignored,
                with a warning.

        Raises:
            InvalidSeedError: if the seed is not an integer, or negative.
            InvalidSceneError: if the scene is not one of the task.
            StateError: if the state is none of an episode of the task that goes on, within the limit.
            SettingsError: if the options are no dict, or more than one of them says how to start; if the variation is
                not in its space.
        """
        seed = None if seed is None else check_seed(seed)
        start = check_options(options, *STARTS)
        if len(given := [name for name in STARTS if start.get(name) is not None]) > 1:
            raise SettingsError(
                f"an episode starts from one of the options {', '.join(STARTS)}, not {' and '.join(given)}"
            )
        scene, state, variation = (
            _scene_option(start, self._engine.setup.body),
            start.get("state"),
            start.get("variation"),
        )
        steps = 0 if self.over else self._engine.steps
        if variation is not None:
            scene, draws = self._varied(variation, self._next_seed(seed))
            self._check_observable(scene)
            self._engine.reset(scene=scene, draws=draws)
        elif scene is not None or state is not None:
            if state is not None:
                check_state(state)
                check_goes_on(state, self._limit)
            self._check_observable(scene if state is None else getattr(state, "scene", None))
            self._engine.reset(scene=scene, state=state)
        else:
            number = self._next_seed(seed)
            if self._engine.task not in TASKS and self._preset.layout == "state":  # the benchmark's own scenes fit
                self._check_observable(self._engine.setup.sample(number))
            self._engine.reset(seed=number)
        super().reset(seed=seed)  # last, so that a reset that is refused leaves the generator as it was
        self._notice_cut(0 if state is not None else steps)
        self._begun = True
        self._fresh_seed = seed if scene is None and state is None else None
        self._stacks.start(self._draw, None if state is None else state.frames)
        return self.observe(), self._info(last=False)

    def get_state(self) -> State:
        """The present state of the episode, to the bit, the pictures in the stacks included.

        Raises:
            gymnasium.error.ResetNeeded: before the first reset.
        """
        if not self._begun:
            raise ResetNeeded("no episode has begun; call reset() before get_state()")
        return dataclasses.replace(self._engine.get_state(), frames=self._stacks.save())

    def set_state(self, state: State) -> None:
        """Goes back to a state, of this environment or another with the same task: what follows is the same to the bit.

        Where the state's pictures are not those of this environment's preset, the present ones fill the stacks. To see
        the observation at once, use `reset(options={"state": state})`.

        Raises:
            StateError: if it is no state of a scene of this task.
            InvalidSceneError: if its scene is not one of this task.
        """
        self._engine.set_state(state)
        self._cut = 0, 0
        self._begun, self._fresh_seed = True, None
        self._stacks.start(self._draw, state.frames)

    def __copy__(self) -> MagicalEnv:
        """As a deep copy: two environments that step the same engine would disturb each other."""
        return self.clone()

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
        last = self.advance(self.to_action(action))
        observation = self.observe()
        return observation, *self.outcome(last=last)

    def to_action(self, action: Any) -> Any:
        """An action as the engine takes it; an `InvalidActionError` if it is a vector, and not one of these."""
        return to_discrete(action) if self._continuous else action

    def advance(self, action: Any) -> bool:
        """The simulation of a step, with its pictures: see `step`. Returns whether it was the episode's last."""
        if not self._begun or self.over:
            raise ResetNeeded("the episode has ended; call reset() before the next step")
        over = self._engine.step(action)
        self._fresh_seed = None
        self._stacks.push(self._draw)
        return over or self.over

    @property
    def over(self) -> bool:
        """Whether the episode has ended."""
        return self._engine.over or self._engine.steps >= self._limit

    def outcome(self, *, last: bool) -> tuple[float, bool, bool, dict[str, Any]]:
        """The reward of a step, whether it was the last (never by termination), and the info."""
        info = self._info(last=last)
        return float(info["eval_score"]) if self.reward == "score" else 0.0, False, last, info

    def render(self) -> Images | None:
        """The view of `render_view` if `render_mode` is "rgb_array". Shape (size, size, 3); "both": twice as wide."""
        if self.render_mode is None:
            gymnasium.logger.warn('render() draws nothing: make the environment with render_mode="rgb_array"')
            return None
        return np.concatenate([self._engine.render(view, self._render_size) for view in self._views], axis=1)

    def close(self) -> None:
        """Frees the simulation; closing twice is fine."""
        self._engine.close()
        super().close()

    def _info(self, *, last: bool) -> dict[str, Any]:
        """The same keys always. TorchRL reads the `dtype` of each value; vectors would lose that of a `numpy.bool`."""
        score = self.score() if last or self._score_every_step else 0.0
        reached = score if last else 0.0
        info = {"eval_score": np.float64(reached), "is_success": np.array(reached == 1.0)}
        shifts = self._engine.simulation.shifts
        if self._instruction or (shifts is not None and shifts.changes_instruction):
            info["instruction"] = np.str_(self.instruction)  # `check_env` cannot compare arrays of text
        return info | {"score": np.float64(score)} if self._score_every_step else info

    def _notice_cut(self, steps: int) -> None:
        """Warns if one episode after the other is reset at this step, as in a `TimeLimit`, which cannot be seen."""
        self._cut = steps, self._cut[1] + 1 if steps == self._cut[0] else 1
        if self._cut == (steps, CUTS) and steps > self._limit / 2:
            warnings.warn(
                f"the last {CUTS} episodes were reset after {steps} of {self._limit} steps. If a wrapper such as "
                "TimeLimit ends them, eval_score is 0.0 there: put magical_mj.wrappers.ScoreAtTheEnd around it, or "
                "give max_episode_steps to gymnasium.make",
                stacklevel=3,
            )

    def _next_seed(self, seed: int | None) -> int:
        """The seed of an episode: the given one, that of the last reset if no step has followed it, or a drawn one."""
        seed = self._fresh_seed if seed is None else seed
        return int(self.np_random.integers(2**63)) if seed is None else seed

    def _varied(self, variation: Any, seed: int) -> tuple[Scene, Draws]:
        """The scene and the draws of an episode with this variation; see `reset`."""
        engine, space = self._engine, self.variation_space
        if not isinstance(variation, Mapping):
            return space.episode(space.draw(variation, seed % MAX_SEED), engine.setup.sample(seed))
        seed = check_seed(variation.get("seed", seed))
        scene, shifts = engine.setup.begin(engine.shifts, seed)
        values = space.values_of(scene, {} if shifts is None else shifts.draws, seed % MAX_SEED)
        for name, part in variation.items():
            check_name("part of a variation", name, space.spaces)
            values[name] = {**values[name], **part} if isinstance(part, Mapping) else part
        return space.episode(values, scene)

    def _draw(self, view: str, place: Images) -> None:
        self._engine.render(view, len(place), out=place if place.shape[2] == 3 else place[..., 0])

    def _check_observable(self, scene: Scene | None) -> None:
        """Raises an `InvalidSceneError`, while the present episode can go on, if the state vector is too short."""
        if scene is not None and self._preset.layout == "state":
            StateEncoder(scene)

    def state(self) -> NDArray[np.float32]:
        """The state vector."""
        return self._engine.state_vector()

    def observe(self, out: Observation | None = None) -> Observation:
        """The present observation, in fresh arrays or in those of `out`."""
        if self._preset.layout == "state":
            return _put(self.state(), out)
        parts: dict[str, NDArray[Any]] = {**self._stacks.latest}
        if self._preset.layout != "dict":
            return _put(next(iter(parts.values())), out)
        if self._preset.fingers:
            with np.errstate(all="ignore"):  # angles may be too small for float32
                parts["fingers"] = self._engine.fingers().astype(np.float32)
        seen: dict[str, Any] = {name: _put(part, None if out is None else out[name]) for name, part in parts.items()}
        if self._instruction:
            seen["instruction"] = self.instruction
        return seen


def _put(values: NDArray[Any], out: Any) -> NDArray[Any]:
    """A copy of an array, fresh or in `out`."""
    if out is None:
        return values.copy()
    np.copyto(out, values)
    return out


def _scene_option(options: Mapping[str, Any], body: str) -> Scene | None:
    """The scene of the options, which as JSON may name the environment's own body."""
    scene = options.get("scene")
    if scene is None or isinstance(scene, Scene):
        return scene
    if isinstance(scene, str | bytes):
        return Scene.from_json(scene, trusted=[body])
    raise InvalidSceneError(f'options["scene"] must be a Scene or its JSON, not {type(scene).__name__}')


def check_options(options: Mapping[str, Any] | None, *known: str) -> Mapping[str, Any]:
    """The options given to an environment's `reset`. Of names that are not known it warns: libraries have their own.

    Raises:
        SettingsError: if they are neither a mapping nor None.
    """
    names = " and ".join(f'"{name}"' for name in known)
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        raise SettingsError(f"options are a dict with {names} for keys, not {short_repr(options)}")
    if ignored := options.keys() - set(known):
        warnings.warn(
            f"reset ignores the options {', '.join(sorted(map(repr, ignored)))}; it knows {names}", stacklevel=3
        )
    return options
