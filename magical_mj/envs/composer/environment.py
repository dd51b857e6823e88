"""The dm_env environment: dm_control's composer simulates a scene, with the score and horizon of a task if given.

It uses only composer's public interface. Its physics equals an engine's, to the bit.
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

from magical_mj.engine import State
from magical_mj.engine.engine import Engine, restored
from magical_mj.engine.episode import Setup
from magical_mj.engine.simulation import Simulation, different_numbers
from magical_mj.envs.composer.task import LoadSettings, SceneTask
from magical_mj.envs.old_names import with_old_names
from magical_mj.observations import CAMERAS, VIEWS
from magical_mj.rendering.backend import check_renderer
from magical_mj.rendering.picture import check_picture, check_size
from magical_mj.scene import Scene, check_scene_type
from magical_mj.scene.bodies import GRIPPER
from magical_mj.shifts.episode import EpisodeShifts
from magical_mj.shifts.registry import Shifts, split_body
from magical_mj.tasks.registry import task_spec
from magical_mj.tasks.spec import Reward, Rules
from magical_mj.utils.errors import ClosedError, CopyError, SettingsError, check_name
from magical_mj.variants import check_seed

AT_COMPILATION: Final = ("initialize_episode_mjcf", "after_compile")
"""Hooks that composer calls only when it compiles the tree."""
TIMING_OPTIONS: Final = ("update_interval", "buffer_size", "delay")
"""Options of observables that cannot be copied: they need earlier observations."""
SUBSTEP_HOOKS: Final = ("before_substep", "after_substep")


class Environment(composer.Environment):
    """A composer environment that simulates scenes. Make one with `magical_mj.load` or `load_scene`."""

    task: SceneTask

    def __init__(self, task: SceneTask, seed: int | None, *, fixed: bool, recompile: bool) -> None:
        """Compiles the first scene.

        Args:
            task: the composer task.
            seed: the seed of the first scene and of the generator that draws the seeds of later scenes. None: the
                generator draws the first seed as well, so that adapters can seed it before the first reset.
            fixed: whether every episode starts in the same scene.
            recompile: composer's `recompile_mjcf_every_episode`.
        """
        self._fixed, self._recompile, self._hooks_added = fixed, recompile, list[tuple[str, Callable[..., Any]]]()
        self._first_seed: int | None = None if fixed else seed
        self._over, self._closed, self._never_reset = True, False, True
        self.seed = self._first_seed
        """The seed of the current episode's scene; None if the scene was not drawn from a seed."""
        self._attributes = frozenset[str]()
        self._compile(task, np.random.RandomState(np.random.MT19937(np.random.SeedSequence(seed))))
        self._attributes = frozenset(vars(self))

    def _compile(self, task: SceneTask, random_state: np.random.RandomState) -> None:
        """Compiles the trees by calling composer's constructor again. A reset compiles only with `recompile`."""
        task.compile_next()
        super().__init__(
            task,
            random_state=random_state,
            strip_singleton_obs_buffer_dim=True,
            recompile_mjcf_every_episode=self._recompile,
        )
        task.root_entity.compiled()
        for name, hook in self._hooks_added:
            super().add_extra_hook(name, hook)

    @property
    def scene(self) -> Scene:
        """The current scene, with the poses of robot, blocks and fingers."""
        return self.task.simulation(self._opened()).scene

    @property
    def initial_scene(self) -> Scene:
        """The initial scene of this episode."""
        return self.task.scene_model.scene

    @property
    def horizon(self) -> int | None:
        """The number of control steps of an episode; None if it never ends."""
        return self.task.horizon

    @property
    def instruction(self) -> str:
        """The sentence that describes the task in this episode, which shifts can change; "" for plain scenes."""
        return self.task.shifts.instruction(self.task.setup.spec.instruction, str(self.task.setup.task))

    def score(self) -> float:
        """The score in [0, 1] if the episode ended now. Raises `InvalidSceneError` for plain scenes."""
        return self.task.simulation(self._opened()).score()

    def render(self, view: str = "allo", size: int = 384, *, out: NDArray[np.uint8] | None = None) -> NDArray[np.uint8]:
        """A picture of the current state; see `magical_mj.Engine.render`. Segmentations are not available here."""
        check_name("view", view, CAMERAS)
        return self.task.simulation(self._opened()).draw(view, check_picture(view, size, out), out)

    def add_extra_hook(self, hook_name: str, hook_callable: Callable[..., Any]) -> None:
        """Adds a function to one of composer's hooks.

        Raises:
            SettingsError: for hooks of substeps during an episode, and for hooks of compilation if the environment was
                loaded without `recompile_mjcf_every_episode`.
        """
        if hook_name in SUBSTEP_HOOKS and not (self._over or self.task.stepwise):
            raise SettingsError(f"add {hook_name} before reset(), or after the last step of an episode")
        if hook_name in AT_COMPILATION and not self._recompile:
            raise SettingsError(
                f"{hook_name} is only called when the tree is compiled: "
                "load the environment with recompile_mjcf_every_episode=True"
            )
        super().add_extra_hook(hook_name, hook_callable)
        self._hooks_added.append((hook_name, hook_callable))
        self.task.substeps_hooked |= hook_name in SUBSTEP_HOOKS

    def reset(
        self, *, seed: int | None = None, scene: Scene | None = None, state: State | None = None
    ) -> dm_env.TimeStep:
        """Starts an episode. Without arguments, the environment's generator draws the scene, unless that is fixed.

        Args:
            seed: the seed of this episode's scene. Scenes of later episodes do not depend on it.
            scene: the initial scene.
            state: a state of an episode that has not ended; the episode continues from it.

        Raises:
            InvalidSeedError, InvalidSceneError, StateError: for the reasons given by `magical_mj.Engine.reset`.
            SettingsError: if more than one of seed, scene and state is given, if the scene is fixed and a seed is
                given, or if the tree was changed in a way that the scene does not allow.
        """
        self._opened()
        self.task.setup.check_start(seed=seed, scene=scene, state=state, limit=self.horizon)
        setup, strengths = self.task.setup, self.task.settings.strengths
        if state is not None:
            return self._start(*setup.scene_and_shifts({}, scene=state.scene, draws=state.draws), state=state)
        if seed is not None and self._fixed:
            raise SettingsError(
                "every episode of load_scene starts in the same scene, whatever the seed: give a scene instead"
            )
        if scene is None and self._fixed:
            scene = self.initial_scene
        if scene is not None:
            return self._start(*setup.scene_and_shifts(strengths, scene=scene))
        if seed is None:
            seed = self._first_seed
        if seed is None:
            seed = int(self.random_state.randint(2**63 - 1, dtype=np.int64))
        return self._start(*setup.scene_and_shifts(strengths, check_seed(seed)), seed=seed)

    def _start(
        self, scene: Scene, shifts: EpisodeShifts, seed: int | None = None, state: State | None = None
    ) -> dm_env.TimeStep:
        task = self.task
        task.start(scene, shifts, state)
        self.seed, self._first_seed, self._over = seed, None, True  # over until the reset has succeeded
        if self._recompile:
            if task.root_entity.edited:  # composer looks for the hooks of new entities only in its constructor
                self._compile(task, self.random_state)
        elif self._never_reset or task.outdated:
            task.root_entity.refuse_variations()
            if not self._never_reset:  # composer's own reset compiles the first time
                task.compile_next()
                task.root_entity.show(scene)  # composer compiles this scene
                self._compile(task, self.random_state)
        self._never_reset = False  # also if composer compiles, and a hook fails afterwards
        timestep = super().reset()
        if state is not None:
            task.simulation(self.physics).resume(state)  # again: composer's reset has computed accelerations since
        self._over = task.should_terminate_episode(self.physics)
        return timestep

    def step(self, action: Any) -> dm_env.TimeStep:
        """Executes one action of 1/8 s. After the last step of an episode, the next call starts a new episode.

        Raises:
            InvalidActionError: if the action is not one of the 18.
            dm_control.rl.control.PhysicsError: if the simulation becomes unstable. This ends the episode.
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
        """The exact current state of the episode. Engines and Gymnasium environments can restore it as well."""
        return self.task.state(self._opened())

    def set_state(self, state: State) -> None:
        """Restores a state of this environment or of another one with the same task. The episode continues exactly.

        Takes as long as a reset, and calls the hooks of a reset. The errors are those of `magical_mj.Engine.set_state`.
        """
        physics = self._opened()
        self.task.setup.check_state(state)
        if state.scene == self.initial_scene:
            self.task.simulation(physics).restore(state.simulation)  # raises errors before anything is changed
        self._start(*self.task.setup.scene_and_shifts({}, scene=state.scene, draws=state.draws), state=state)

    def to_engine(self) -> Engine:
        """A new engine in the same state of the same episode, for exports and for the scripted expert.

        Raises:
            SettingsError: if users have changed the model, since an engine contains only the scene.
        """
        state, task = self.get_state(), self.task
        if changed := ["the MJCF tree"] if task.root_entity.edited else self._foreign_numbers():
            raise SettingsError(
                f"this environment's model was changed ({', '.join(changed[:5])}), and an engine contains only the "
                "scene. dm_control.mjcf.export_with_assets(env.task.root_entity.mjcf_model, folder) writes everything"
            )
        settings, horizon = task.settings, self.horizon
        return restored(task.setup, settings.strengths, self.seed, state, False, horizon, settings.renderer)

    def _foreign_numbers(self) -> list[str]:
        """The names of numbers that differ between the compiled model and the model of the current episode's scene."""
        task = self.task
        shifts = EpisodeShifts({} if self._never_reset else task.shifts.draws)
        own = Simulation.of(self.initial_scene, shifts)
        return different_numbers(self.physics.model.ptr, own.model)

    def clone(self) -> Environment:
        """A copy in the same state. It continues in the same way, also in later episodes. Takes as long as loading.

        The copy has the same enabled observables, with their corruptors, aggregators and sizes. Other changes that
        users have made cannot be copied.

        Raises:
            StateError: if users have made other changes. The message names them.
        """
        return _copied(*self._parts())

    def __deepcopy__(self, memo: dict[int, Any]) -> Environment:
        return self.clone()

    def __reduce__(self) -> tuple[Any, ...]:
        """For pickling: the values that `clone` copies."""
        parts = self._parts()
        for name, options in parts[-1].items():
            try:
                pickle.dumps(options)
            except (pickle.PicklingError, AttributeError, TypeError) as error:
                raise CopyError(
                    f"the corruptor or aggregator of observable {name!r} cannot be pickled: {error}"
                ) from error
        return _copied, parts

    def _parts(self) -> tuple[Any, ...]:
        """The arguments of `_copied`: those of loading, the generators, the state, and the observables' options."""
        self._opened()
        task = self.task
        loaded = task.settings, self.initial_scene, EpisodeShifts(task.shifts.draws)
        if changes := self._changes(SceneTask(*loaded)):
            raise CopyError(
                f"this environment was changed, so it cannot be copied or pickled: {', '.join(changes)}. Load another "
                "environment, make the same changes, and call its set_state() with the result of get_state()"
            )
        seeds = self.random_state.get_state(legacy=False), self.seed, self._first_seed
        state = None if self._over else self.get_state()
        options = {name: _options(entry) for name, entry in task.observables.items()}
        return loaded, seeds, self._fixed, self._recompile, state, options

    def _changes(self, fresh: SceneTask) -> list[str]:
        """Descriptions of users' changes that cannot be copied, compared with a new task with the same arguments."""
        task = self.task
        kinds = (self, Environment), (task, SceneTask)
        added = (vars(self).keys() - self._attributes) | (vars(task).keys() - vars(fresh).keys())
        known = fresh.observables
        changes = [f"the class {type(own).__name__}" for own, kind in kinds if type(own) is not kind]
        changes += [f"the attribute {name!r}" for name in sorted(added)]
        changes += [f"a hook {name}" for name, _ in self._hooks_added]
        for name, entry in task.observables.items():
            if type(entry) is not type(known.get(name)):
                changes.append(f"the observable {name!r}")
            elif any(getattr(entry, key) != getattr(known[name], key) for key in TIMING_OPTIONS):
                changes.append(f"the buffer or delay of the observable {name!r}")
        changes += [
            f"the observable '{block.name}/{name}' of a block that is not in this episode"
            for block in task.root_entity.absent
            for name, entry in block.observables.as_dict(fully_qualified=False).items()
            if entry.enabled
        ]
        changes += [f"the removed observable {name!r}" for name in known.keys() - task.observables.keys()]
        mine, other = (each.root_entity.mjcf_model.to_xml_string() for each in (task, fresh))
        if mine != other:
            changes.append("the MJCF tree")
        elif numbers := self._foreign_numbers():
            changes += [f"physics.model.{name}" for name in numbers]
        return changes

    def close(self) -> None:
        """Frees the simulation. Can be called more than once."""
        if not self._closed:
            self._closed = True
            self.task.free()
            super().close()

    def _opened(self) -> Any:
        """The physics, if the environment is open."""
        if self._closed:
            raise ClosedError("the environment is closed: load another one")
        return self.physics


def _options(entry: observable.Observable) -> dict[str, Any]:
    """All options of an observable, such as the size of a camera's pictures, except those of its timing."""
    options = {}
    for name in dir(type(entry)):
        is_settable = getattr(getattr(type(entry), name), "fset", None) is not None
        if is_settable and name not in TIMING_OPTIONS:
            options[name] = getattr(entry, name)
    return options


def _copied(
    loaded: tuple[Any, ...],
    seeds: tuple[Any, ...],
    fixed: bool,
    recompile: bool,
    state: State | None,
    options: dict[str, dict[str, Any]],
) -> Environment:
    """A copy of an environment, made from the result of `Environment._parts`. Without a state, it needs a reset."""
    env = Environment(SceneTask(*loaded), 0, fixed=fixed, recompile=recompile)
    for name, values in options.items():
        env.task.observables[name].configure(**values)
    if state is not None:
        env.set_state(state)
    generator, env.seed, env._first_seed = seeds
    env.random_state.set_state(generator)
    return env


@with_old_names
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
    """A dm_env environment of the benchmark, built with dm_control's composer; see docs/composer.md.

    Its MJCF tree is `env.task.root_entity.mjcf_model`. Changes of the tree and of observables take effect at the next
    reset. Some attributes are determined by the scene; changing them raises an error (docs/composer.md). The tree is
    compiled again after a change, and if an episode has other blocks than the previous one. Otherwise the scene is
    written into the compiled model, which takes a millisecond.

    Example:
        >>> env = magical_mj.load("MoveToRegion", "Jitter", seed=0, observations=["state"])
        >>> timestep = env.reset()
        >>> while not timestep.last():
        ...     timestep = env.step(1)
        >>> 0 <= env.score() <= 1
        True

    Args:
        task: one of `magical_mj.TASKS`, a task of an installed plug-in, or ``"package.module:SPEC"``.
        variant: a variant of the task, one of `magical_mj.VARIANTS`.
        seed: the first episode starts in `sample_scene(task, variant, seed)`, later ones in scenes drawn by a
            generator with this seed. None: seeded from the system's entropy.
        scene: the initial scene of every episode instead.
        observations: any of "ego", "allo", "state", "ego_stack" and "allo_stack". Stacks are the last four frames of a
            view along the channels, oldest first: the benchmark's LoRes4E and LoRes4A.
        image_size: side of the pictures in pixels.
        reward: "none" (always 0: the benchmark has no reward), "score" (the score at the last step), or "dense": at
            each step the decrease of the remaining distance, and the score at the last step (docs/rewards.md).
        rules: "paper", or "released" for the scores and horizons of the original's released code.
        shifts: shifts and their strengths, such as "camera:3,latency:1" or a dict; see docs/shifts.md.
        renderer: the renderer of observations, "opengl" or "software"; None: MAGICAL_MJ_RENDERER, or the first that
            works.
        body: the robot's body; see docs/bodies.md.
        recompile_mjcf_every_episode: whether to compile the tree for every episode. Hooks that change the tree need it.

    Raises:
        TaskError, InvalidSceneError, InvalidSeedError, ShiftError: for the reasons given by `magical_mj.Engine`.
        UnknownNameError: for an unknown task, variant, observation, reward or rules, or if the task does not have the
            variant.
        SettingsError: if the image size, the list of observations, the shifts or the body are invalid.
    """
    task_spec(task)  # rejects None as well, which is the task of plain scenes in `Setup`
    strengths, body = split_body(shifts, task, body)
    setup, renderer = Setup(task, variant, rules, body), check_renderer(renderer)
    settings = LoadSettings(setup, strengths, observations, check_size(image_size), reward, renderer)
    return _loaded(settings, seed, scene, recompile=recompile_mjcf_every_episode)


@with_old_names
def load_scene(
    scene: Scene,
    *,
    seed: int | None = None,
    observations: Sequence[str] = VIEWS,
    image_size: int = 96,
    renderer: str | None = None,
    recompile_mjcf_every_episode: bool = False,
) -> Environment:
    """A dm_env environment that starts every episode in `scene`. Without a task, it has no score and no horizon.

    Example:
        >>> scene = Scene(Robot(0, -0.5, 0), [Block("star", "red", 0, 0.2, 0)])
        >>> env = magical_mj.load_scene(scene, observations=["state"])
        >>> timestep = env.reset()
        >>> for _ in range(8):  # one second forward, against the block
        ...     timestep = env.step(1)
        >>> env.scene.blocks[0].y > 0.2
        True

    For the arguments and errors, see `load`.
    """
    settings = LoadSettings(Setup(None), {}, observations, check_size(image_size), "none", check_renderer(renderer))
    return _loaded(settings, seed, check_scene_type(scene), recompile=recompile_mjcf_every_episode)


def _loaded(settings: LoadSettings, seed: int | None, scene: Scene | None, *, recompile: bool) -> Environment:
    seed = None if seed is None else check_seed(seed)
    first = settings.setup.scene_and_shifts(settings.strengths, seed or 0, scene)
    return Environment(SceneTask(settings, *first), seed, fixed=scene is not None, recompile=recompile)
