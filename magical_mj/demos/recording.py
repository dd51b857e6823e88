"""Recording and replaying: steps of an engine become a demonstration, as recordings of what was played elsewhere do.

A recording, as the page in the browser saves it, is a small JSON object in UTF-8:

| key | value |
|---|---|
| `format` | 1 |
| `protocol` | the `magical_mj.tasks.protocol.PROTOCOL` under which it was played |
| `task`, `variant` | names, as in `magical_mj.ENVIRONMENTS` |
| `seed` | an integer: the episode started in `sample_scene(task, variant, seed)` |
| `actions` | a list of integers in 0..17, one for each step of a whole episode |
| `final` | the poses that the player saw at the end, in world units and radians; optional |

`final` is `{"robot": [x, y, angle], "fingers": [left, right], "blocks": [[x, y, angle], ...]}`. Other keys are ignored.
Only task, variant, seed and actions are trusted: the scene is drawn again, the actions are replayed here, and the
demonstration holds the states and the score of this replay. `final` is compared with its end.
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

from magical_mj.assets.world import World
from magical_mj.demos.demonstration import Demonstration, Demonstrator, check_physical
from magical_mj.engine import Engine
from magical_mj.policies.expert import expert_of
from magical_mj.policies.interface import play_actions
from magical_mj.rendering.canvas import Picture
from magical_mj.scene.actions import NOOP, Action, action_number, to_vector
from magical_mj.scene.bodies import GRIPPER
from magical_mj.shifts.registry import Shifts, parse_shifts, shift_label
from magical_mj.tasks.protocol import PROTOCOL
from magical_mj.tasks.registry import sample_scene, score_trajectory, task_name, variant_name
from magical_mj.utils.errors import DemonstrationError
from magical_mj.variants import check_seed

Floats = NDArray[np.float64]

ATTEMPTS: Final = 10
REST: Final = 80
"""Steps without an action after which an expert's demonstration ends, if the episode does not end before."""
SHORT_REST: Final = 3
"""As `REST`, in SweepToTop, where debris stays where it lies."""
STRIDE: Final = 1_000_003
"""The increment of the expert's seed between attempts, so that no two demonstrations use the same one."""
MAX_BYTES: Final = 100_000
"""The largest size of a recording: many times that of the longest episode."""
TOLERANCE: Final = 1e-3
"""The difference (world units or radians) between the end of a replay and what the player saw that is accepted."""
GLANCE: Final = 10  # steps between the pictures that are compared
SIZE: Final = 96  # pixels
ROUNDING: Final = 1e-9
TOUCHED: Final = 0.05  # world units; a block that moved less does not count as moved
SIDES: Final = 8  # from which a block can be taken
SAMPLES: Final = 50  # points of a path


class Recorder:
    """Steps an engine and records actions and states of one episode, at whose start it must be made.

    Raises:
        DemonstrationError: if the episode has begun already.
    """

    def __init__(self, env: Engine) -> None:
        if env.steps:
            raise DemonstrationError(f"the episode began {env.steps} steps ago: reset the environment before")
        self._env = env
        self._actions: list[Any] = []
        self._positions = [env.data.qpos.copy()]
        self._velocities = [env.data.qvel.copy()]

    def step(self, action: Any) -> bool:
        """One action, as the engine takes it. Returns whether the episode is over.

        Raises:
            DemonstrationError: if the episode is over, or went on without this recorder.
            InvalidActionError: if the action is not one of the 18.
        """
        if self._env.over:
            raise DemonstrationError("the episode is over: reset the environment, and record with another Recorder")
        self._check_complete()
        if self._env.setup.speeds:
            size = 3 if self._env.simulation.world.has_fingers else 2
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
        """The episode so far as a demonstration, with the present score by the paper's rules.

        The seed is the expert's; None: the scene's.

        Raises:
            InvalidSeedError: if the seed is not an integer, or negative.
            DemonstrationError: if the episode did not begin in the scene of a seed, or went on without this recorder;
                if it has shifts that demonstrations cannot have.
        """
        env = self._env
        self._check_complete()
        if env.task is None or env.seed is None:
            raise DemonstrationError("only episodes that begin in the scene of a seed become demonstrations")
        task, shifts = task_name(env.task), shift_label(env.shifts)
        check_physical(shifts)
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
        if self._env.steps != len(self._actions):
            raise DemonstrationError("the environment was reset or stepped without the recorder: make another one")


def demonstrate(
    task: str, variant: str, number: int, least_score: float = 1.0, body: str = GRIPPER, shifts: Shifts = None
) -> Demonstration:
    """A demonstration by the expert with this body: `number` is the seed of the scene and of the expert.

    If the expert does not reach `least_score`, experts with other seeds try. Shifts are physical ones.

    Raises:
        InvalidSeedError: if `number` is not an integer, or negative.
        DemonstrationError: if none of them reaches it; for shifts that demonstrations cannot have.
        UnknownNameError, SettingsError: for wrong shifts.
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
    """The demonstration of somebody's actions in the scene of a seed, which are played again.

    Raises:
        DemonstrationError: if they are not a whole episode.
    """
    actions = list(actions)
    with closing(Engine(task, variant, seed=seed)) as env:
        if len(actions) != env.horizon:
            raise DemonstrationError(
                f"an episode of {task} has {env.horizon} actions; this recording has {len(actions)}"
            )
        recorder = Recorder(env)
        for action in actions:
            recorder.step(action)
        return recorder.demonstration(demonstrator)


class Imported(NamedTuple):
    """A demonstration, and the difference between its end and what the player saw."""

    demonstration: Demonstration
    deviation: float | None
    """The largest difference of any coordinate or angle; None if the recording has no `final`."""

    suspect: bool
    """Whether that is more than `TOLERANCE`: the player saw something different from the demonstration."""


Pose = tuple[float, float, float]
Name = Annotated[str, Meta(pattern=r"^[^\W\d]\w{0,59}\Z")]
"""No "module:SPEC": a file must not choose code to load."""


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
    """Replays a recording, whose keys are listed above, and makes a demonstration of the replay.

    Raises:
        DemonstrationError: if it is too long, not JSON, of another format or protocol, or not a whole episode.
        UnknownNameError: if there is no such environment.
    """
    recording = _decoded(text)
    demonstration = recorded(recording.task, recording.variant, recording.seed, recording.actions, "human")
    final, blocks = recording.final, len(demonstration.scene.blocks)
    if final is None:
        return Imported(demonstration, None, suspect=False)
    if len(final.blocks) != blocks:
        raise DemonstrationError(f"final must hold the poses of {blocks} blocks, not of {len(final.blocks)}")
    end = World(demonstration.scene).read(demonstration.qpos[-1])
    replayed = _Final(end.robot.pose, end.robot.fingers, [block.pose for block in end.blocks])
    deviation = float(np.abs(_numbers(replayed) - _numbers(final)).max())
    return Imported(demonstration, deviation, deviation > TOLERANCE)


def _decoded(text: str | bytes) -> _Recording:
    if not isinstance(text, str | bytes):
        raise DemonstrationError(f"a recording is given as its text, not as {type(text).__name__}")
    if len(text) > MAX_BYTES:
        raise DemonstrationError(f"a recording has at most {MAX_BYTES:,} bytes; this one is longer")
    try:
        recording = msgspec.json.decode(text, type=_Recording)
    except (ValueError, RecursionError) as error:
        raise DemonstrationError(f"this is not a whole recording: {error}") from None
    if recording.protocol != PROTOCOL:
        raise DemonstrationError(f"recordings of protocol {PROTOCOL} are replayed here, not of {recording.protocol}")
    return recording


def _numbers(final: _Final) -> Floats:
    return np.concatenate([final.robot, final.fingers, *final.blocks])


class Verdict(NamedTuple):
    """The result of checking a demonstration."""

    scene: bool
    """The scene is still that of its seed, and the recorded states begin in it."""
    score: bool
    """The last state has the recorded score."""
    replay: bool
    """The same actions lead to the same score, and all of them are within the episode."""
    exact: bool
    """The same actions lead to exactly the same states: so with the machine and versions of the recording."""
    pictures: bool
    """The pictures of the replay equal those of the recorded states, pixel by pixel."""

    @property
    def good(self) -> bool:
        """Whether the demonstration is what it says it is."""
        return self.problem is None

    @property
    def problem(self) -> str | None:
        """What is wrong, to be said after the demonstration's name; None if nothing is."""
        if not self.scene:
            return "does not start in the scene that its variant and seed have in this version of the world"
        return None if self.score and self.replay else "does not replay to its score in this version of the world"


def verify(demo: Demonstration) -> Verdict:
    """Checks a demonstration with this version of the package and of MuJoCo."""
    drawn = [pictures["allo"] for pictures in itertools.islice(render_demo(demo), 0, None, GLANCE)]
    body = demo.scene.robot.body
    start = _start(demo)
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


def _start(demo: Demonstration) -> dict[str, Any]:
    """The engine's arguments for the demonstration's start: shifts draw from its seed, and may change pictures, too."""
    return {"seed": demo.scene_seed, "shifts": demo.shifts} if demo.shifts else {"scene": demo.scene}


def render_demo(
    demo: Demonstration, views: Sequence[str] = ("allo",), size: int = SIZE, renderer: str | None = None
) -> Iterator[dict[str, Picture]]:
    """The pictures before the first action and after each action, drawn from the recorded states.

    Args:
        demo: the demonstration.
        views: any of "ego" and "allo", and of "ego-segmentation" and "allo-segmentation".
        size: side of the pictures in pixels.
        renderer: what draws them, as in `magical_mj.Engine`.

    Yields:
        View -> picture, shape (size, size, 3).
    """
    body = demo.scene.robot.body
    with closing(Engine(demo.task, demo.variant, **_start(demo), renderer=renderer, body=body)) as env:
        for positions in demo.qpos:
            env.data.qpos[:] = positions
            mujoco.mj_kinematics(env.model, env.data)
            mujoco.mj_camlight(env.model, env.data)
            yield {view: env.render(view, size) for view in views}


class Diversity(NamedTuple):
    """What differs in a set of demonstrations."""

    orders: int
    """Different orders in which blocks were moved."""
    strategies: int
    """Different orders, with the side from which each block was moved."""
    ways: float
    """Mean distance (world units) between two paths of the robot, at equal fractions of their lengths."""


def diversity(demos: Iterable[Demonstration]) -> Diversity:
    """Compares demonstrations of one environment."""
    demos = list(demos)
    plans = [strategy(demo) for demo in demos]
    orders = {tuple(block for block, _ in plan) for plan in plans}
    paths = [_path(demo) for demo in demos]
    gaps = [float(np.hypot(*(first - second).T).mean()) for first, second in itertools.combinations(paths, 2)]
    return Diversity(len(orders), len(set(plans)), sum(gaps) / len(gaps) if gaps else 0.0)


def strategy(demo: Demonstration) -> tuple[tuple[int, int], ...]:
    """The blocks that were moved, in order, each with the side (0..7, by compass) from which the robot came."""
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
    places = _poses(demo)[:, 0, :2]
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(places, axis=0).T))])
    at = np.linspace(0, length[-1], SAMPLES)
    return np.stack([np.interp(at, length, places[:, axis]) for axis in (0, 1)], axis=1)


def _poses(demo: Demonstration) -> NDArray[np.float64]:
    """The poses of the robot and the blocks at each time. Shape (steps + 1, 1 + blocks, 3)."""
    world = World(demo.scene)
    return np.array([world.poses(qpos) for qpos in demo.qpos])
