"""The Gymnasium environment: an engine with observations, rewards and infos."""

from __future__ import annotations

import copy
import dataclasses
import math
import warnings
from collections.abc import Mapping
from functools import cached_property
from typing import Any, Final, Literal, get_args

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from magical_mj.actions import ACTIONS, as_speeds, to_discrete
from magical_mj.engine import Engine, State
from magical_mj.envs.old_names import with_old_names
from magical_mj.envs.presets import (
    PRESETS,
    Images,
    Preset,
    frame_stacks,
    observation_space,
    preset_named,
    saved_frames,
)
from magical_mj.envs.variation import MAX_SEED, Variation, VariationSpace
from magical_mj.observations import CAMERAS, VIEWS, StateEncoder
from magical_mj.rendering.backend import drawn_by
from magical_mj.rendering.picture import check_size
from magical_mj.scene import Scene
from magical_mj.scene import constants as c
from magical_mj.scene.bodies import GRIPPER
from magical_mj.shifts.episode import Draws
from magical_mj.shifts.registry import Shifts, shift_label
from magical_mj.tasks.registry import TASKS, task_spec
from magical_mj.tasks.spec import REWARDS, Reward, Rules
from magical_mj.utils.errors import SettingsError, check_name, short_repr
from magical_mj.utils.imports import reference_to
from magical_mj.variants import check_seed
from magical_mj.wrappers import check_limit, vectors

ActionForm = Literal["discrete", "continuous", "speeds"]
ACTION_FORMS: Final[tuple[str, ...]] = get_args(ActionForm)
Observation = NDArray[Any] | dict[str, NDArray[Any]]

CUTS: Final = 3
"""After at least this number of episodes that are reset at the same step, a warning says that they report no score."""
RENDER_VIEWS: Final = (*CAMERAS, "both")
STARTS: Final = ("scene", "state", "variation")
"""The options of `reset` that determine how an episode starts."""


class MagicalEnv(gymnasium.Env[Observation, Any]):
    """One of the benchmark's environments; make it with `gymnasium.make("magical_mj/...")`.

    Example:
        >>> env = gymnasium.make("magical_mj/FindDupe-TestShape-State-v0")
        >>> observation, info = env.reset(seed=7)  # starts in magical_mj.sample_scene("FindDupe", "Shape", 7)
        >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        >>> info["eval_score"].item()  # the score of the episode, at its last step
        0.0

    ## Actions
    `Discrete(18)`: 9 * gripper + 3 * turn + drive; see `magical_mj.actions`. One action lasts 1/8 s. With
    `action="continuous"`, vectors (drive, turn, grip) in [-1, 1]; see `magical_mj.wrappers.ContinuousActions`.
    With `action="speeds"`, x-magical's vectors: see `magical_mj.xmagical.envs.XMagicalEnv`.

    ## Observations
    They depend on the preset (`magical_mj.envs.presets.PRESETS`): uint8 pictures stacked along the channels, oldest
    first; the state vector; or pictures and the fingers' angles. After a reset the first frame fills the stack.

    ## Episodes
    `reset(seed=7)` starts in `sample_scene(task, variant, 7)`; `reset()` in a scene drawn by `np_random`;
    `reset(options={"scene": scene})` in this `Scene`, which may be given as JSON. `reset(options={"state": state})`
    continues from a result of `get_state()`. An episode is truncated at the task's horizon and never terminates. The
    reward is 0, unless `reward` says otherwise. At the last step, `info["eval_score"]` is the score in [0, 1], and
    `info["is_success"]` is whether it is 1. Before, `eval_score` is 0.0.

    Args:
        task: one of `magical_mj.TASKS`.
        variant: one of `magical_mj.VARIANTS`.
        preset: one of `magical_mj.envs.presets.PRESETS`.
        image_size: side of the pictures in pixels, instead of the preset's.
        reward: "none"; "score", the score at the last step; or "dense", at each step the decrease of the remaining
            distance, and the score at the last step (docs/rewards.md).
        rules: "paper", or "released" for the scores and horizons of the original's released code.
        action: "discrete", "continuous" or "speeds".
        renderer: "opengl" or "software" for flat views; None: MAGICAL_MJ_RENDERER, or the first that works
            (docs/pictures.md).
        shifts: shifts and their strengths, such as "camera:3,latency:1" or a dict; see docs/shifts.md.
        body: the robot's body; see docs/bodies.md.
        instruction: adds the sentence that describes the task to infos, as `info["instruction"]`, and to observations
            that are dicts. If a shift changes the sentence, infos contain it in any case.
        render_mode: "rgb_array"; Gymnasium makes "human" (a window) from it.
        render_view: the view of `render`: "ego", "allo", "both" side by side, or "scene", in 3-D from above a corner.
        render_size: side of each view in pixels.
        score_every_step: adds `info["score"]` at every step and reset: the score if the episode ended now. With the
            preset State, steps take a quarter to a half longer.
        limit: the number of steps of an episode, if fewer than the task's horizon.

    Attributes:
        engine: the engine that this environment runs.
        reward: the reward, see above.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": c.CONTROL_RATE}  # noqa: RUF012

    @with_old_names
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
        self._stacks = frame_stacks(self._preset, size)
        named = (name for name, known in PRESETS.items() if known == self._preset and size == known.image_size)
        self._preset_name = next(filter(None, named), None)
        check_name("reward", reward, REWARDS)
        task_spec(task).check_reward(reward)
        self.reward: Reward = reward
        self._remaining = 0.0  # before the last step, for dense rewards
        self.engine = Engine(
            task, variant, seed=0, rules=rules, renderer=renderer, shifts=shifts, body=body, speeds=action == "speeds"
        )
        if limit is not None:
            self.limit = limit
        self._action: ActionForm = action
        self._action_size = 3 if action == "continuous" or self.engine.scene_model.has_fingers else 2
        self.action_space = spaces.Discrete(len(ACTIONS)) if action == "discrete" else vectors(self._action_size)
        self._instruction = instruction
        self.observation_space = observation_space(self._preset, size, instruction=instruction)
        self._score_every_step = score_every_step
        self._begun = False
        self._cut = 0, 0  # the step of the last episodes' early resets, and the number of these episodes
        self._fresh_seed: int | None = None  # the seed of the last reset, until the first step

    @property
    def scene(self) -> Scene:
        """The current scene, with the poses of robot, blocks and fingers."""
        return self.engine.scene

    @property
    def initial_scene(self) -> Scene:
        """The initial scene of this episode."""
        return self.engine.initial_scene

    @property
    def conditions(self) -> dict[str, Any]:
        """The properties that results record: task, variant, rules, body, shift, preset, renderer and class."""
        engine = self.engine
        return {
            "task": engine.task,
            "variant": engine.variant,
            "rules": engine.rules,
            "body": engine.setup.body,
            "shift": shift_label(engine.shifts),
            "preset": self._preset_name,
            "gl": drawn_by(engine.renderer),
            "kind": reference_to(type(self)),
        }

    @property
    def instruction(self) -> str:
        """The sentence that describes the task in this episode. Shifts can change it."""
        return self.engine.instruction

    @property
    def limit(self) -> int:
        """The number of steps of an episode. If it continues from a state, the steps before the state count."""
        return self.engine.limit or 0

    @limit.setter
    def limit(self, steps: int) -> None:
        self.engine.limit = check_limit(steps, self.engine.setup)

    @cached_property
    def variation_space(self) -> VariationSpace:
        """The space of all factors of scenes and shifts; see `magical_mj.envs.variation` and docs/shifts.md."""
        return VariationSpace(self.engine)

    @property
    def variation(self) -> Variation:
        """The current episode's values in `variation_space`. `reset` with the option "variation" repeats them."""
        engine = self.engine
        seeds = {int(values["seed"]) for values in engine.draws.values()} or {engine.seed or 0}
        return self.variation_space.values_of(engine.initial_scene, engine.draws, min(seeds))

    def score(self) -> float:
        """The score in [0, 1] if the episode ended now."""
        return self.engine.score()

    def score_on_end_of_traj(self) -> float:
        """Deprecated name of `score`, from the original and from x-magical."""
        warnings.warn("score_on_end_of_traj() is deprecated: call score()", FutureWarning, stacklevel=2)
        return self.score()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None, out: Observation | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode; see the class.

        Args:
            seed: draws this episode's scene, and seeds `np_random`, which draws the seeds of later episodes. If no step
                follows, the next reset without a seed starts in the same scene: some libraries reset an extra time in
                their `set_seed`.
            options: one of "scene", "state" and "variation". A variation is a dict of values in `variation_space`
                (missing values are those of the seed's episode), or a list of names of factors to draw. Other options
                are ignored with a warning.
            out: the arrays for the observation; None: fresh ones.

        Raises:
            InvalidSeedError, InvalidSceneError, StateError: for the reasons given by `magical_mj.Engine.reset`.
            SettingsError: if the options are not a dict, if they give more than one start, or if the variation is not
                in its space.
        """
        seed = None if seed is None else check_seed(seed)
        scene = state = variation = draws = number = None
        if options is not None:
            scene, state, variation = self._start_options(check_options(options, *STARTS))
        engine = self.engine
        steps = 0 if engine.over or state is not None else engine.steps
        if state is not None:
            self._check_observable(getattr(state, "scene", None))
            engine.reset(state=state)
        else:
            if variation is not None:
                scene, draws = self._varied(variation, self._next_seed(seed))
            elif scene is None:
                number = self._next_seed(seed)
            first, shifts = engine.setup.scene_and_shifts(engine.shifts, number, scene, draws)
            if number is None or engine.task not in TASKS:  # drawn scenes of the benchmark's tasks fit
                self._check_observable(first)
            engine.start(first, shifts, number)
        super().reset(seed=seed)  # last, so that a refused reset does not change the generator
        self._notice_cut(steps)
        self._begun = True
        self._fresh_seed = None if number is None else seed
        for name, stack in self._stacks.items():
            stack.start(engine.draw, None if state is None else state.frames.get(name))
        return self.observe(out), self._info(last=False)

    def get_state(self) -> State:
        """The exact current state of the episode, including the frames in the stacks.

        Raises:
            gymnasium.error.ResetNeeded: before the first reset.
        """
        if not self._begun:
            raise ResetNeeded("no episode has started: call reset() before get_state()")
        return dataclasses.replace(self.engine.get_state(), frames=saved_frames(self._stacks))

    def set_state(self, state: State) -> None:
        """Restores a state of this environment or of another one with the same task. The episode continues exactly.

        If the state has no frames of this environment's preset, the current picture fills the stacks. To get the
        observation as well, use `reset(options={"state": state})`. For errors, see `magical_mj.Engine.set_state`.
        """
        self.engine.set_state(state)
        self._cut = 0, 0
        self._begun, self._fresh_seed = True, None
        for name, stack in self._stacks.items():
            stack.start(self.engine.draw, state.frames.get(name))

    def __copy__(self) -> MagicalEnv:
        """A deep copy: two environments with the same engine would disturb each other."""
        return self.clone()

    def __getstate__(self) -> dict[str, Any]:
        """For copying and pickling. Gymnasium creates the generator at its first use; the copy needs it."""
        _ = self.np_random
        return self.__dict__

    def clone(self) -> MagicalEnv:
        """A copy in the same state. It continues in the same way, also in later episodes."""
        return copy.deepcopy(self)

    def step(
        self, action: Any, out: Observation | None = None
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Executes one action. The episode is truncated at the horizon.

        Args:
            action: a member of the action space.
            out: the arrays for the observation; None: fresh ones.

        Raises:
            InvalidActionError: if the action is not in the action space.
            gymnasium.error.ResetNeeded: before the first reset, and after the last step of an episode.
        """
        if not self._begun or self.engine.over:
            raise ResetNeeded("the episode has ended: call reset() before the next step")
        if self._action != "discrete":
            action = self.to_action(action)
        if self.reward == "dense":
            self._remaining = self.engine.remaining()
        last = self.engine.step(action)  # ten substeps
        self._fresh_seed = None
        for stack in self._stacks.values():
            stack.push(self.engine.draw)
        info = self._info(last=last)
        return self.observe(out), self._reward(info), False, last, info

    def to_action(self, action: Any) -> Any:
        """Converts an action for the engine. Raises `InvalidActionError` if vectors are invalid."""
        if self._action == "speeds":
            return as_speeds(action, self._action_size)
        return to_discrete(action) if self._action == "continuous" else action

    def _reward(self, info: dict[str, Any]) -> float:
        """The reward of the last step, which has this info."""
        if self.reward == "none":
            return 0.0
        reward = float(info["eval_score"])
        return reward if self.reward == "score" else reward + self._remaining - self.engine.remaining()

    def render(self) -> Images | None:
        """The picture of `render_view`, shape (size, size, 3); twice as wide for "both". None without `render_mode`."""
        if self.render_mode is None:
            gymnasium.logger.warn('render() draws nothing: make the environment with render_mode="rgb_array"')
            return None
        return np.concatenate([self.engine.render(view, self._render_size) for view in self._views], axis=1)

    def close(self) -> None:
        """Frees the simulation. Can be called more than once."""
        self.engine.close()
        super().close()

    def _info(self, *, last: bool) -> dict[str, Any]:
        """The info, always with the same keys. JSON can hold it, and arrays of its values have the right types."""
        score = self.score() if last or self._score_every_step else 0.0
        reached = score if last else 0.0
        info = {"eval_score": np.float64(reached), "is_success": bool(reached == 1.0)}
        if self._instruction or self.engine.episode_shifts.changes_instruction:
            info["instruction"] = np.str_(self.instruction)  # not an array: `check_env` cannot compare arrays of text
        if self._score_every_step:
            info["score"] = np.float64(score)
        return info

    def _notice_cut(self, steps: int) -> None:
        """Warns if consecutive episodes are reset at this step, probably by a wrapper such as `TimeLimit`.

        It warns once these episodes have together as many steps as a whole one, so that a few short trials do not.
        """
        self._cut = steps, self._cut[1] + 1 if steps == self._cut[0] else 1
        limit = self.engine.limit or 0
        enough = max(CUTS, math.ceil(limit / max(steps, 1)))
        if steps and self._cut == (steps, enough):
            warnings.warn(
                f"the last {enough} episodes were reset after {steps} of {limit} steps. If a wrapper such as "
                "TimeLimit ends them, their eval_score is 0.0: apply magical_mj.wrappers.ScoreAtTheEnd outside that "
                "wrapper, or give max_episode_steps to gymnasium.make",
                stacklevel=3,
            )

    def _start_options(self, start: Mapping[str, Any]) -> tuple[Scene | None, Any, Any]:
        """The options "scene", "state" and "variation". The scene's JSON may name the environment's own body."""
        if len(given := [name for name in STARTS if start.get(name) is not None]) > 1:
            raise SettingsError(f"give only one of the options {', '.join(STARTS)}, not {' and '.join(given)}")
        scene = start.get("scene")
        if isinstance(scene, str | bytes):
            scene = Scene.from_json(scene, trusted=[self.engine.setup.body])
        return scene, start.get("state"), start.get("variation")

    def _next_seed(self, seed: int | None) -> int:
        """The seed of an episode: the given seed, the seed of the last reset if no step followed, or a drawn seed."""
        seed = self._fresh_seed if seed is None else seed
        return int(self.np_random.integers(2**63)) if seed is None else seed

    def _varied(self, variation: Any, seed: int) -> tuple[Scene, Draws]:
        """The scene and the shifts' values of an episode with this variation; see `reset`."""
        engine, space = self.engine, self.variation_space
        if not isinstance(variation, Mapping):
            return space.episode(space.draw(variation, seed % MAX_SEED), engine.setup.scene_and_shifts({}, seed)[0])
        seed = check_seed(variation.get("seed", seed))
        scene, shifts = engine.setup.scene_and_shifts(engine.shifts, seed)
        values = space.values_of(scene, shifts.draws, seed % MAX_SEED)
        for name, part in variation.items():
            check_name("key of a variation", name, space.spaces)
            values[name] = {**values[name], **part} if isinstance(part, Mapping) else part
        return space.episode(values, scene)

    def _check_observable(self, scene: object) -> None:
        """Raises an `InvalidSceneError` if the state vector is too short for a scene, before anything is changed."""
        if isinstance(scene, Scene) and self._preset.layout == "state":
            StateEncoder(scene)

    def state_vector(self) -> NDArray[np.float32]:
        """The state vector; see `magical_mj.Engine.state_vector`."""
        return self.engine.state_vector()

    def observe(self, out: Observation | None = None) -> Observation:
        """The current observation, in fresh arrays or in those of `out`."""
        if self._preset.layout == "state":
            return _put(self.engine.state_vector(start=True) if self._preset.start else self.state_vector(), out)
        if self._preset.layout != "dict":
            (stack,) = self._stacks.values()
            return _put(stack.latest, out)
        parts: dict[str, NDArray[Any]] = {name: stack.latest for name, stack in self._stacks.items()}
        if self._preset.fingers:
            with np.errstate(all="ignore"):  # angles may underflow in float32
                parts["fingers"] = self.engine.fingers().astype(np.float32)
        observed: dict[str, Any] = {
            name: _put(part, None if out is None else out[name]) for name, part in parts.items()
        }
        if self._instruction:
            observed["instruction"] = self.instruction
        return observed


def _put(values: NDArray[Any], out: Any) -> NDArray[Any]:
    """Copies an array into `out`, or into a fresh array."""
    if out is None:
        return values.copy()
    np.copyto(out, values)
    return out


def check_options(options: Mapping[str, Any] | None, *known: str) -> Mapping[str, Any]:
    """Checks the options of an environment's `reset`. Unknown ones cause a warning, since libraries pass their own."""
    if not options and (options is None or isinstance(options, Mapping)):
        return {}
    names = " and ".join(f'"{name}"' for name in known)
    if not isinstance(options, Mapping):
        raise SettingsError(f"options must be a dict with keys among {names}, not {short_repr(options)}")
    if ignored := options.keys() - set(known):
        warnings.warn(
            f"reset ignores the options {', '.join(sorted(map(repr, ignored)))}; known options: {names}", stacklevel=3
        )
    return options
