"""The dm_env environment: dm_control's composer runs a scene, with a task's score and horizon if there is a task.

It uses composer's public interface only, and steps the same physics as an engine: to the bit.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from typing import Any, Final

import dm_env
import numpy as np
from dm_control import composer
from dm_control.composer.observation import observable
from dm_control.rl.control import PhysicsError
from numpy.typing import NDArray

from magical_mj.assets.world import Structure
from magical_mj.engine import State
from magical_mj.engine.engine import Engine, Setup, restored
from magical_mj.engine.simulation import Simulation, check_state, different_numbers
from magical_mj.envs.composer.task import SceneTask, Settings
from magical_mj.rendering.backend import check_renderer
from magical_mj.rendering.renderer import check_size
from magical_mj.scene import Scene, check_scene_type
from magical_mj.scene.bodies import GRIPPER
from magical_mj.scene.state_vector import CAMERAS, VIEWS
from magical_mj.shifts.episode import EpisodeShifts
from magical_mj.shifts.registry import Shifts, split_body
from magical_mj.tasks.registry import task_spec
from magical_mj.tasks.spec import Reward, Rules
from magical_mj.utils.errors import ClosedError, SettingsError, StateError, check_name
from magical_mj.variants import check_seed

AT_COMPILATION: Final = ("initialize_episode_mjcf", "after_compile")
"""Hooks that composer calls only when it compiles the tree."""
TIMING_OPTIONS: Final = ("update_interval", "buffer_size", "delay")
"""Options of observables that copies cannot have: they need earlier observations."""
SUBSTEP_HOOKS: Final = ("before_substep", "after_substep")


class Environment(composer.Environment):
    """A composer environment that knows its scene. Make one with `magical_mj.load` or `load_scene`."""

    task: SceneTask

    def __init__(self, task: SceneTask, seed: int | None, *, fixed: bool, recompile: bool) -> None:
        """Compiles the first scene.

        Args:
            task: runs the scenes.
            seed: the seed of the first scene unless that is fixed, and of the generator of the seeds of later ones.
                None: the generator draws the first one, too, so that adapters may seed it before the first reset.
            fixed: whether every episode starts in the same scene.
            recompile: composer's `recompile_mjcf_every_episode`.
        """
        self._fixed, self._recompile, self._hooks_added = fixed, recompile, list[tuple[str, Callable[..., Any]]]()
        self._first_seed: int | None = None if fixed else seed
        self._over, self._closed, self._never_reset = True, False, True
        self.seed = self._first_seed
        """The seed of the present scene; None if it came from elsewhere."""
        self._attributes = frozenset[str]()
        self._compile(task, np.random.RandomState(np.random.MT19937(np.random.SeedSequence(seed))))
        self._attributes = frozenset(vars(self))

    def _compile(self, task: SceneTask, random_state: np.random.RandomState) -> None:
        """Makes composer's part anew: that is how it compiles another tree where it does not do so in every episode."""
        self._structure = None  # until it has succeeded
        task.compile_next()
        super().__init__(
            task,
            random_state=random_state,
            strip_singleton_obs_buffer_dim=True,
            recompile_mjcf_every_episode=self._recompile,
        )
        task.root_entity.compiled()
        self._structure: Structure | None = task.world.structure
        for name, hook in self._hooks_added:
            super().add_extra_hook(name, hook)

    @property
    def scene(self) -> Scene:
        """Where everything is now, fingers included."""
        return self.task.simulation(self._opened()).scene

    @property
    def initial_scene(self) -> Scene:
        """The scene in which this episode started."""
        return self.task.world.scene

    @property
    def horizon(self) -> int | None:
        """Number of control steps of an episode; None if it never ends."""
        return self.task.setup.horizon

    @property
    def instruction(self) -> str:
        """The sentence that says what is to be done in this episode, as its shifts make it; "" for plain scenes."""
        return self.task.setup.instruction(self.task.shifts)

    def score(self) -> float:
        """The score in [0, 1] if the episode ended now; an `InvalidSceneError` for plain scenes."""
        return self.task.score(self._opened())

    def render(self, view: str = "allo", size: int = 384, *, out: NDArray[np.uint8] | None = None) -> NDArray[np.uint8]:
        """A picture of the present state, as `magical_mj.Engine.render`."""
        check_name("view", view, CAMERAS)
        return self.task.simulation(self._opened()).draw(view, check_size(size, "size"), out)

    def add_extra_hook(self, hook_name: str, hook_callable: Callable[..., Any]) -> None:
        """Adds a function to one of composer's hooks.

        Raises:
            SettingsError: for a hook that is called at compilation only, which episodes mostly do without.
        """
        if hook_name in SUBSTEP_HOOKS and not (self._over or self.task.stepwise):
            raise SettingsError(f"add {hook_name} before reset(), or after the last step of an episode")
        if hook_name in AT_COMPILATION and not self._recompile:
            raise SettingsError(
                f"{hook_name} is called only when the tree is compiled: "
                "load the environment with recompile_mjcf_every_episode=True"
            )
        super().add_extra_hook(hook_name, hook_callable)
        self._hooks_added.append((hook_name, hook_callable))
        self.task.substeps_hooked |= hook_name in SUBSTEP_HOOKS

    def reset(
        self, *, seed: int | None = None, scene: Scene | None = None, state: State | None = None
    ) -> dm_env.TimeStep:
        """Starts an episode in `scene`, or in the scene of `seed`, or else in a scene drawn by the environment.

        Args:
            seed: the seed of this episode's scene; scenes of later episodes do not depend on it.
            scene: the scene in which to start.
            state: a state of an episode that goes on, to continue from.

        Raises:
            InvalidSceneError, InvalidSeedError, StateError, SettingsError: if it is invalid; if there is more than one.
        """
        self._opened()
        self.task.setup.check_start(seed=seed, scene=scene, state=state)
        setup, strengths = self.task.setup, self.task.settings.strengths
        if state is not None:
            return self._start(*setup.begin({}, scene=state.scene, draws=state.draws), state=state)
        if scene is None and self._fixed:
            scene = self.initial_scene
        if scene is not None:
            return self._start(*setup.begin(strengths, scene=scene))
        if seed is None:
            seed = self._first_seed
        if seed is None:
            seed = int(self.random_state.randint(2**63 - 1, dtype=np.int64))
        return self._start(*setup.begin(strengths, check_seed(seed)), seed=seed)

    def _start(
        self, scene: Scene, shifts: EpisodeShifts | None, seed: int | None = None, state: State | None = None
    ) -> dm_env.TimeStep:
        task = self.task
        task.start(scene, shifts, state)
        self.seed, self._first_seed, self._over = seed, None, True  # over until it has succeeded
        if self._recompile:
            if task.root_entity.edited:  # with new entities, whose hooks composer looks for when it compiles
                self._compile(task, self.random_state)
        elif self._never_reset or task.world.structure != self._structure or task.outdated:
            task.root_entity.refuse_variations()
            if not self._never_reset:  # else composer compiles by itself
                task.compile_next()
                task.root_entity.show(scene)  # what composer observes now
                self._compile(task, self.random_state)
        timestep = super().reset()
        self._never_reset = False
        if state is not None:
            task.resume(self.physics, state)  # to the bit: composer has solved for accelerations since
        self._over = task.should_terminate_episode(self.physics)
        return timestep

    def step(self, action: Any) -> dm_env.TimeStep:
        """One action of 1/8 s. After the last step of an episode, the next call starts another one.

        Raises:
            InvalidActionError: if the action is not one of the 18.
            dm_control.rl.control.PhysicsError: if the simulation becomes unstable, which ends the episode.
        """
        self._opened()
        if self._over:
            return self.reset()
        try:
            timestep = super().step(action)
        except PhysicsError:
            self._over = True
            raise
        self._over = timestep.last()
        return timestep

    def get_state(self) -> State:
        """The present state of the episode, exactly: engines and Gymnasium's environments can go on from it, too."""
        return self.task.state(self._opened())

    def set_state(self, state: State) -> None:
        """Restores a state of this environment, or of another one with the same task: what follows is exactly the same.

        It takes as long as a reset, and calls its hooks.

        Raises:
            StateError, InvalidSceneError: if it is none of this task. A damaged one of another scene ends the episode.
        """
        physics = self._opened()
        check_state(state)
        self.task.setup.trajectory_of(state)
        if state.scene == self.initial_scene:
            self.task.simulation(physics).restore(state.simulation)  # raises an error while nothing has changed
        self._start(*self.task.setup.begin({}, scene=state.scene, draws=state.draws), state=state)

    def to_engine(self) -> Engine:
        """An engine in the same state of the same episode: to export it, or to ask the scripted expert. It is a copy.

        Raises:
            SettingsError: if users' parts or numbers make the model another one than that of the scene.
        """
        state, task = self.get_state(), self.task
        if changed := ["the MJCF tree"] if task.root_entity.edited else self._foreign_numbers():
            raise SettingsError(
                f"users have changed this environment's model ({', '.join(changed[:5])}), and engines hold the scene "
                "alone. dm_control.mjcf.export_with_assets(env.task.root_entity.mjcf_model, folder) writes everything"
            )
        return restored(task.setup, task.settings.strengths, self.seed, state, False, task.settings.renderer)

    def _foreign_numbers(self) -> list[str]:
        """In which numbers the compiled model differs from that of the present episode."""
        task = self.task
        shifts = None if task.shifts is None or self._never_reset else EpisodeShifts(task.shifts.draws)
        own = Simulation.of(self.initial_scene, shifts=shifts, speeds=task.setup.speeds)
        return different_numbers(self.physics.model.ptr, own.model)

    def clone(self) -> Environment:
        """A copy in the same state, in as long as loading takes. Both behave the same, also in later episodes.

        Which observables are enabled, with their corruptors, aggregators and sizes, is copied as well. What else users
        have changed cannot be.

        Raises:
            StateError: if users have changed anything else of this environment; it says what.
        """
        return _copied(*self._parts())

    def __deepcopy__(self, memo: dict[int, Any]) -> Environment:
        return self.clone()

    def __reduce__(self) -> tuple[Any, ...]:
        """For pickling: what `clone` copies, if it can be pickled."""
        parts = self._parts()
        for name, options in parts[-1].items():
            try:
                pickle.dumps(options)
            except (pickle.PicklingError, AttributeError, TypeError) as error:
                raise StateError(
                    f"the corruptor or aggregator of observable {name!r} cannot be pickled: {error}"
                ) from error
        return _copied, parts

    def _parts(self) -> tuple[Any, ...]:
        """What it was loaded with, the generators, the state of the episode, and its observables' options.

        Raises:
            StateError: if there is more to it.
        """
        self._opened()
        task = self.task
        shifts = None if task.shifts is None else EpisodeShifts(task.shifts.draws)
        loaded = task.settings, self.initial_scene, shifts
        if changes := self._changes(SceneTask(*loaded)):
            raise StateError(
                f"users have changed this environment, so that it cannot be copied or pickled: {', '.join(changes)}. "
                "Load another one, make the same changes, and call its set_state() with this one's get_state()"
            )
        seeds = self.random_state.get_state(legacy=False), self.seed, self._first_seed
        state = None if self._over else self.get_state()
        options = {name: _options(it) for name, it in task.observables.items()}
        return loaded, seeds, self._fixed, self._recompile, state, options

    def _changes(self, fresh: SceneTask) -> list[str]:
        """What users have changed that a copy would not have.

        Args:
            fresh: a task as this environment's was before.
        """
        task = self.task
        kinds = (self, Environment), (task, SceneTask)
        changes = [f"the class {type(it).__name__}" for it, kind in kinds if type(it) is not kind]
        added = (vars(self).keys() - self._attributes) | (vars(task).keys() - vars(fresh).keys())
        changes += [f"the attribute {name!r}" for name in sorted(added)]
        changes += [f"a hook {name}" for name, _ in self._hooks_added]
        known = fresh.observables
        for name, it in task.observables.items():
            if type(it) is not type(known.get(name)):
                changes.append(f"the observable {name!r}")
            elif any(getattr(it, key) != getattr(known[name], key) for key in TIMING_OPTIONS):
                changes.append(f"the buffer or delay of the observable {name!r}")
        changes += [
            f"the observable '{block.name}/{name}' of a block that this episode lacks"
            for block in task.root_entity.absent
            for name, it in block.observables.as_dict(fully_qualified=False).items()
            if it.enabled
        ]
        changes += [f"no observable {name!r}" for name in known.keys() - task.observables.keys()]
        mine, other = (it.root_entity.mjcf_model.to_xml_string() for it in (task, fresh))
        if mine != other:
            changes.append("the MJCF tree")
        elif numbers := self._foreign_numbers():
            changes += [f"physics.model.{name}" for name in numbers]
        return changes

    def close(self) -> None:
        """Frees the simulation. Closing twice is fine."""
        if not self._closed:
            self._closed = True
            self.task.free()
            super().close()

    def _opened(self) -> Any:
        """The physics."""
        if self._closed:
            raise ClosedError("the environment is closed; load another one")
        return self.physics


def _options(it: observable.Observable) -> dict[str, Any]:
    """All that can be set of an observable, such as the size of a camera's pictures, but for its timing."""
    settable = (name for name in dir(type(it)) if getattr(getattr(type(it), name), "fset", None) is not None)
    return {name: getattr(it, name) for name in settable if name not in TIMING_OPTIONS}


def _copied(
    loaded: tuple[Any, ...],
    seeds: tuple[Any, ...],
    fixed: bool,
    recompile: bool,
    state: State | None,
    options: dict[str, dict[str, Any]],
) -> Environment:
    """A copy of an environment, from what `Environment._parts` returns; without a state, at the end of an episode."""
    env = Environment(SceneTask(*loaded), 0, fixed=fixed, recompile=recompile)
    for name, values in options.items():
        env.task.observables[name].configure(**values)
    if state is not None:
        env.set_state(state)
    generator, env.seed, env._first_seed = seeds
    env.random_state.set_state(generator)
    return env


def load(
    task: str,
    variant: str = "Demo",
    *,
    seed: int | None = None,
    scene: Scene | None = None,
    observations: Sequence[str] = VIEWS,
    image_size: int = 96,
    reward: Reward = "none",
    rules: Rules = "paper",
    shifts: Shifts = None,
    renderer: str | None = None,
    body: str = GRIPPER,
    recompile_mjcf_every_episode: bool = False,
) -> Environment:
    """A dm_env environment of the benchmark, by dm_control's composer: docs/composer.md.

    Its MJCF tree is `env.task.root_entity.mjcf_model`. What users change there, or in observables, counts from the next
    reset; an error names what the scene owns (docs/composer.md). The tree is compiled again where it was changed, and
    where an episode has other blocks than the one before. In between, a scene is written into the compiled model, which
    takes a millisecond.

    Args:
        task: one of `magical_mj.TASKS`, a task that a package announces, or ``"package.module:SPEC"``.
        variant: one of `magical_mj.VARIANTS` that the task has.
        seed: the first episode starts in `sample_scene(task, variant, seed)`, the following ones in scenes
            drawn from a generator with this seed. None: seeded from the system's entropy.
        scene: start every episode in this scene instead.
        observations: any of "ego", "allo" and "state", and of "ego_stack" and "allo_stack", the last four frames of a
            view along the channels, oldest first: the benchmark's LoRes4E and LoRes4A.
        image_size: side of the pictures in pixels.
        reward: "none" (always 0: the benchmark has no reward) or "score" (the score, at the last step).
        rules: "paper", or "released" for the scores and horizons of the original's released code.
        shifts: shifts and their strengths, such as "camera:3,latency:1" or a dict; see docs/shifts.md.
        renderer: what draws observations, "opengl" or "software"; None: MAGICAL_MJ_RENDERER, or what works.
        body: the robot's body, one that the task offers; see docs/bodies.md.
        recompile_mjcf_every_episode: compile the tree for every episode, as hooks need that change it.

    Raises:
        UnknownNameError: for an unknown task, variant, observation, reward or rules, or an unsupported pair.
        TaskError: if the task of another package is invalid.
        InvalidSceneError: if the scene is illegal or not one of the task.
        InvalidSeedError, SettingsError: for a bad seed; for a bad image size, list of observations, or shifts.
        ShiftError: if a shift of another package is invalid.
    """
    task_spec(task)  # None, too, is no task
    strengths, body = split_body(shifts, task, body)
    setup, renderer = Setup(task, variant, rules, body), check_renderer(renderer)
    settings = Settings(setup, strengths, observations, check_size(image_size), reward, renderer)
    return _loaded(settings, seed, scene, recompile=recompile_mjcf_every_episode)


def load_scene(
    scene: Scene,
    *,
    seed: int | None = None,
    observations: Sequence[str] = VIEWS,
    image_size: int = 96,
    renderer: str | None = None,
    recompile_mjcf_every_episode: bool = False,
) -> Environment:
    """A dm_env environment that starts every episode in `scene`: no task, so no score and no horizon.

    Raises:
        UnknownNameError, InvalidSceneError, InvalidSeedError, SettingsError: as `load`.
    """
    settings = Settings(Setup(None), {}, observations, check_size(image_size), "none", check_renderer(renderer))
    return _loaded(settings, seed, check_scene_type(scene), recompile=recompile_mjcf_every_episode)


def _loaded(settings: Settings, seed: int | None, scene: Scene | None, *, recompile: bool) -> Environment:
    seed = None if seed is None else check_seed(seed)
    first = settings.setup.begin(settings.strengths, seed or 0, scene)
    return Environment(SceneTask(settings, *first), seed, fixed=scene is not None, recompile=recompile)
