"""Records demonstrations from an engine, imports recordings of other programs, and replays demonstrations.

A recording is a small JSON object in UTF-8, such as the browser page saves:

| key | value |
|---|---|
| `format` | 1 |
| `protocol` | the value of `magical_mj.protocol.PROTOCOL` in the program that played it |
| `task`, `variant` | names from `magical_mj.ENVIRONMENTS` |
| `seed` | an integer: the episode started in `sample_scene(task, variant, seed)` |
| `actions` | a list of integers in 0..17, one for each step of a complete episode |
| `final` | optional: the poses that the player saw at the end, in world units and radians |

`final` is `{"robot": [x, y, angle], "fingers": [left, right], "blocks": [[x, y, angle], ...]}`. Other keys are ignored.
Only task, variant, seed and actions are used: the scene is sampled again, and the actions are replayed. The
demonstration contains the states and the score of this replay. `final` is compared with the end of the replay.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from typing import Annotated, Any, Final, Literal, NamedTuple

import msgspec
import mujoco
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from magical_mj.actions import NOOP, Action, action_number, to_vector
from magical_mj.assets.scene_model import SceneModel
from magical_mj.demos.demonstration import Demonstration, Demonstrator, check_physical
from magical_mj.engine import Engine
from magical_mj.engine.simulation import Simulation
from magical_mj.experts import expert_of
from magical_mj.policies.interface import play_actions
from magical_mj.protocol import PROTOCOL
from magical_mj.rendering.backend import check_renderer
from magical_mj.rendering.picture import Picture, check_picture
from magical_mj.scene.bodies import GRIPPER
from magical_mj.shifts.episode import EpisodeShifts, draw_shifts
from magical_mj.shifts.registry import Shifts, parse_shifts, shift_label, split_body
from magical_mj.tasks.registry import sample_scene, score_trajectory, task_name, task_spec, variant_name
from magical_mj.utils.errors import DemonstrationError, short_repr
from magical_mj.variants import check_seed

Floats = NDArray[np.float64]

ATTEMPTS: Final = 10
REST: Final = 80
"""An expert's demonstration ends after this number of successive no-ops, or with the episode."""
SHORT_REST: Final = 3
"""`REST` in tasks with speeds, such as SweepToTop."""
STRIDE: Final = 1_000_003
"""The increment of the expert's seed between attempts. It is large, so that demonstrations do not share seeds."""
MAX_BYTES: Final = 100_000
"""The maximum size of a recording. The longest episode needs much less."""
TOLERANCE: Final = 1e-3
"""The accepted difference (world units or radians) between the end of a replay and the recording's `final`."""
GLANCE: Final = 10  # steps: every tenth picture is compared
SIZE: Final = 96  # pixels
ROUNDING: Final = 1e-9
TOUCHED: Final = 0.05  # world units; a block that moved less does not count as moved
SIDES: Final = 8  # the number of sides of a block that strategies distinguish
SAMPLES: Final = 50  # the number of points on a path


class Recorder:
    """Steps an engine, and records the actions and states of one episode. Create it at the start of the episode.

    Raises:
        DemonstrationError: if the episode has begun already.
    """

    def __init__(self, env: Engine) -> None:
        if env.steps:
            raise DemonstrationError(f"the episode began {env.steps} steps ago: reset the environment first")
        self._env = env
        self._actions: list[Any] = []
        self._positions = [env.data.qpos.copy()]
        self._velocities = [env.data.qvel.copy()]

    def step(self, action: Any) -> bool:
        """Performs an action, in any form that `Engine.step` accepts. Returns whether the episode is over.

        Raises:
            StateError: if the episode is over.
            DemonstrationError: if the engine was reset, stepped or changed without this recorder.
            InvalidActionError: if the action is not one of the 18.
        """
        self._check_complete()
        if self._env.setup.speeds:
            size = 3 if self._env.scene_model.has_fingers else 2
            is_number = np.ndim(action) == 0 or isinstance(action, Action)
            action = np.asarray(to_vector(action_number(action))[:size] if is_number else action, np.float32)
        over = self._env.step(action)
        self._actions.append(action if self._env.setup.speeds else action_number(action))
        self._positions.append(self._env.data.qpos.copy())
        self._velocities.append(self._env.data.qvel.copy())
        return over

    def idle(self, steps: int) -> bool:
        """Whether the last `steps` actions were all no-ops."""
        last = self._actions[-steps:]
        return len(last) == steps and not any(
            np.any(action[:2]) if np.ndim(action) else action != NOOP for action in last
        )

    def states(self) -> tuple[Floats, Floats]:
        """The positions and the velocities so far. Shapes (steps + 1, nq) and (steps + 1, nv)."""
        return np.array(self._positions), np.array(self._velocities)

    def demonstration(self, demonstrator: Demonstrator, seed: int | None = None) -> Demonstration:
        """The episode so far as a demonstration, with the current score under the paper's rules.

        Args:
            demonstrator: the kind of demonstrator.
            seed: the seed of the expert. None: that of the scene.

        Raises:
            InvalidSeedError: if the seed is not an integer, or negative.
            DemonstrationError: if the episode did not begin in the scene of a seed, if the engine was changed without
                this recorder, or if it has shifts, or values of shifts, that demonstrations cannot have.
        """
        env = self._env
        self._check_complete()
        if env.task is None or env.seed is None:
            raise DemonstrationError(
                "this episode cannot become a demonstration: it must begin in the scene of a seed, env.reset(seed=...)"
            )
        task, shifts = task_name(env.task), shift_label(env.shifts)
        check_physical(shifts)
        if env.draws != draw_shifts(env.shifts, env.seed):
            raise DemonstrationError(
                "this episode cannot become a demonstration: the values of its shifts are not those of its seed, from "
                "which they are drawn again; leave out draws in reset"
            )
        positions, velocities = self.states()
        return Demonstration(
            task=task,
            variant=env.variant,
            scene_seed=env.seed,
            demonstrator=demonstrator,
            seed=env.seed if seed is None else check_seed(seed),
            scene=env.initial_scene,
            actions=np.array(self._actions, np.float32 if env.setup.speeds else np.uint8),
            qpos=positions,
            qvel=velocities,
            score=score_trajectory(task, env.scored_scenes),
            shifts=shifts,
        )

    def _check_complete(self) -> None:
        env = self._env
        if env.steps != len(self._actions) or not (
            np.array_equal(env.data.qpos, self._positions[-1]) and np.array_equal(env.data.qvel, self._velocities[-1])
        ):
            raise DemonstrationError(
                "the environment was reset, stepped or changed without the recorder: create a new one after each reset"
            )


def demonstrate(
    task: str, variant: str, number: int, least_score: float = 1.0, body: str = GRIPPER, shifts: Shifts = None
) -> Demonstration:
    """A demonstration by the expert.

    Args:
        task: the task.
        variant: the variant.
        number: the seed of the scene and of the expert.
        least_score: the required score. If the expert does not reach it, experts with other seeds try.
        body: the robot's body.
        shifts: physical shifts.

    Raises:
        InvalidSeedError: if `number` is not an integer, or negative.
        DemonstrationError: if no expert reaches the score, or for shifts that demonstrations cannot have.
        UnknownNameError, SettingsError: for invalid shifts.
    """
    number = check_seed(number)
    check_physical(shift_label(parse_shifts(shifts, task)))
    best = 0.0
    with closing(Engine(task, variant, seed=number, body=body, shifts=shifts)) as env:
        for attempt in range(ATTEMPTS):
            env.reset(seed=number)
            seed = number + attempt * STRIDE
            expert, recorder = expert_of(env, task, seed), Recorder(env)
            while not (recorder.step(expert()) or recorder.idle(SHORT_REST if env.setup.speeds else REST)):
                pass
            if env.score() >= least_score:
                return recorder.demonstration("expert", seed)
            best = max(best, env.score())
    raise DemonstrationError(
        f"{ATTEMPTS} experts tried {task}-{variant_name(variant)} with seed {number}; the best reached {best:.2f}"
    )


def recorded(task: str, variant: str, seed: int, actions: Iterable[int], demonstrator: Demonstrator) -> Demonstration:
    """The demonstration with these actions in the scene of a seed. The actions are replayed.

    Raises:
        DemonstrationError: if they are not a complete episode.
    """
    actions = list(actions)
    horizon = task_spec(task).horizon()
    if len(actions) != horizon:
        raise DemonstrationError(f"an episode of {task} has {horizon} actions; this recording has {len(actions)}")
    return replayed(task, variant, seed, actions, demonstrator)


def replayed(
    task: str,
    variant: str,
    seed: int,
    actions: Iterable[Any],
    demonstrator: Demonstrator,
    expert: int | None = None,
    body: str = GRIPPER,
) -> Demonstration:
    """The demonstration with these actions in the scene of a seed. `expert` is the seed of the demonstrator, if any."""
    with closing(Engine(task, variant, seed=seed, body=body)) as env:
        recorder = Recorder(env)
        for action in actions:
            recorder.step(action)
        return recorder.demonstration(demonstrator, expert)


class Imported(NamedTuple):
    """An imported demonstration, and the difference between its end and the recording's `final`."""

    demonstration: Demonstration
    deviation: float | None
    """The largest difference of any coordinate or angle. None if the recording has no `final`."""

    suspect: bool
    """Whether the difference exceeds `TOLERANCE`: then the player saw other poses than the demonstration contains."""


Pose = tuple[float, float, float]
Name = Annotated[str, Meta(pattern=r"^[^\W\d]\w{0,59}\Z")]
"""A name, but not a reference "module:SPEC", because a file must not choose code to import."""


class _Final(msgspec.Struct):
    robot: Pose
    fingers: tuple[float, float]
    blocks: list[Pose]


class _Recording(msgspec.Struct):
    format: Literal[1]
    protocol: int
    task: Name
    variant: Name
    seed: Annotated[int, Meta(ge=0, le=2**63 - 1)]
    actions: list[Annotated[int, Meta(ge=0, le=17)]]
    final: _Final | None = None


def from_recording(text: str | bytes) -> Imported:
    """Replays a recording, and returns the demonstration. The module's docstring describes the format.

    Raises:
        DemonstrationError: if it is too long, not JSON, of another format or protocol, or not a complete episode.
        UnknownNameError: for an unknown environment.
    """
    recording = _decoded(text)
    demonstration = recorded(recording.task, recording.variant, recording.seed, recording.actions, "human")
    final, blocks = recording.final, len(demonstration.scene.blocks)
    if final is None:
        return Imported(demonstration, None, suspect=False)
    if len(final.blocks) != blocks:
        raise DemonstrationError(f"final must contain the poses of {blocks} blocks, not of {len(final.blocks)}")
    end = SceneModel(demonstration.scene).read(demonstration.qpos[-1])
    replayed = np.concatenate([end.robot.pose, end.robot.fingers, *(block.pose for block in end.blocks)])
    deviation = float(np.abs(replayed - np.concatenate([final.robot, final.fingers, *final.blocks])).max())
    return Imported(demonstration, deviation, deviation > TOLERANCE)


def _decoded(text: str | bytes) -> _Recording:
    if not isinstance(text, str | bytes) or len(text) > MAX_BYTES:
        raise DemonstrationError(f"a recording must be text of at most {MAX_BYTES:,} bytes, not {short_repr(text)}")
    try:
        recording = msgspec.json.decode(text, type=_Recording)
    except (ValueError, RecursionError) as error:
        raise DemonstrationError(f"this is not a complete recording: {error}") from None
    if recording.protocol != PROTOCOL:
        raise DemonstrationError(
            f"this version replays recordings of protocol {PROTOCOL}, but this recording is of {recording.protocol}"
        )
    return recording


class Verdict(NamedTuple):
    """The result of checking a demonstration."""

    scene: bool
    """Whether the scene is that of its seed, and the recorded states begin in it."""
    score: bool
    """Whether the last state has the recorded score."""
    replay: bool
    """Whether a replay of the actions takes the same number of steps and has the same score."""
    exact: bool
    """Whether a replay has exactly the same states. This requires the machine and versions of the recording."""
    pictures: bool
    """Whether the pictures of the replay equal those of the recorded states, pixel by pixel."""

    @property
    def good(self) -> bool:
        """Whether the demonstration has its recorded scene and score."""
        return self.problem is None

    @property
    def problem(self) -> str | None:
        """The first problem, as a predicate whose subject is the demonstration. None if there is none."""
        if not self.scene:
            return "does not start in the scene of its variant and seed in this version of the package"
        return None if self.score and self.replay else "does not replay to its score in this version of the package"


def verify(demo: Demonstration) -> Verdict:
    """Checks a demonstration with this version of the package and of MuJoCo."""
    drawn = [pictures["allo"] for pictures in itertools.islice(render_demo(demo), 0, None, GLANCE)]
    body = demo.scene.robot.body
    # with shifts it needs the seed, since they draw from it
    start: dict[str, Any] = {"seed": demo.scene_seed, "shifts": demo.shifts} if demo.shifts else {"scene": demo.scene}
    with closing(Engine(demo.task, demo.variant, body=body, **start)) as env:
        expected = env.initial_scene if demo.shifts else sample_scene(demo.task, demo.variant, demo.scene_seed, body)
        recorder, replayed = Recorder(env), [env.render("allo", SIZE)]
        for step, _ in enumerate(play_actions(recorder, demo.actions.tolist()), start=1):
            if step % GLANCE == 0:
                replayed.append(env.render("allo", SIZE))
        positions, velocities = recorder.states()
        score = env.score()
    same_scene = expected == demo.scene and all(
        np.allclose(states[0], recorded[0], rtol=0, atol=ROUNDING)
        for states, recorded in ((positions, demo.qpos), (velocities, demo.qvel))
    )
    same_score = score == demo.score and len(positions) == len(demo.qpos)
    same_states = np.array_equal(positions, demo.qpos) and np.array_equal(velocities, demo.qvel)
    same_pictures = np.array_equal(replayed, drawn)
    return Verdict(same_scene, demo.rescored() == demo.score, same_score, same_states, same_pictures)


def render_demo(
    demo: Demonstration, views: Sequence[str] = ("allo",), size: int = SIZE, renderer: str | None = None
) -> Iterator[dict[str, Picture]]:
    """Renders the pictures before the first and after each action, from the recorded states.

    Args:
        demo: the demonstration.
        views: any of "ego", "allo", "ego-segmentation" and "allo-segmentation".
        size: side of the pictures in pixels.
        renderer: the renderer, see `magical_mj.Engine`.

    Yields:
        View -> picture, shape (size, size, 3).
    """
    for view in views:
        check_picture(view, size)
    for simulation in posed(demo, renderer):
        yield {view: simulation.draw(view, size) for view in views}


def posed(demo: Demonstration, renderer: str | None = None) -> Iterator[Simulation]:
    """The simulation in the states before the first and after each action, for its pictures only. See `render_demo`."""
    check_renderer(renderer)
    strengths, _ = split_body(demo.shifts, demo.task, demo.scene.robot.body)
    shifts = EpisodeShifts(draw_shifts(strengths, demo.scene_seed))
    simulation = Simulation.of(demo.scene, shifts, renderer)
    model, data = simulation.model, simulation.data
    for positions in demo.qpos:
        data.qpos[:] = positions
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        yield simulation


class Diversity(NamedTuple):
    """The variety of a set of demonstrations."""

    orders: int
    """The number of different orders of the moved blocks."""
    strategies: int
    """The number of different orders, if the side of each block that the robot approached also counts."""
    ways: float
    """The mean distance (world units) between two paths of the robot, at equal fractions of their lengths."""


def diversity(demos: Iterable[Demonstration]) -> Diversity:
    """Measures the variety of demonstrations of one environment."""
    demos = list(demos)
    plans = [strategy(demo) for demo in demos]
    orders = {tuple(block for block, _ in plan) for plan in plans}
    paths = [_path(demo) for demo in demos]
    gaps = [float(np.hypot(*(first - second).T).mean()) for first, second in itertools.combinations(paths, 2)]
    return Diversity(len(orders), len(set(plans)), sum(gaps) / len(gaps) if gaps else 0.0)


def strategy(demo: Demonstration) -> tuple[tuple[int, int], ...]:
    """The moved blocks in order, each with the side where the robot was: 0 (east) to 7, counter-clockwise."""
    poses = _poses(demo)
    moves = []
    for block in range(1, poses.shape[1]):
        moved = np.hypot(*(poses[:, block, :2] - poses[0, block, :2]).T) > TOUCHED
        if moved.any():
            when = int(moved.argmax())
            dx, dy = poses[when, 0, :2] - poses[when, block, :2]
            side = round(math.atan2(dy, dx) * SIDES / (2 * math.pi)) % SIDES
            moves.append((when, block - 1, side))
    return tuple((block, side) for _, block, side in sorted(moves))


def _path(demo: Demonstration) -> NDArray[np.float64]:
    """Points at equal distances along the robot's path. Shape (SAMPLES, 2)."""
    positions = _poses(demo)[:, 0, :2]
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(positions, axis=0).T))])
    samples = np.linspace(0, length[-1], SAMPLES)
    return np.stack([np.interp(samples, length, positions[:, axis]) for axis in (0, 1)], axis=1)


def _poses(demo: Demonstration) -> NDArray[np.float64]:
    """The poses of the robot and the blocks at each time. Shape (steps + 1, 1 + blocks, 3)."""
    model = SceneModel(demo.scene)
    return np.array([model.poses(qpos) for qpos in demo.qpos])
