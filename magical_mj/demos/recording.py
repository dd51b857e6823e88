"""Recording: the steps of an engine become a demonstration; so do recordings of what was played elsewhere.

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

from collections.abc import Iterable
from contextlib import closing
from typing import Annotated, Any, Final, Literal, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from magical_mj.assets.world import World
from magical_mj.demos.demonstration import Demonstration, Demonstrator, check_physical
from magical_mj.engine import Engine
from magical_mj.policies.expert import expert_of
from magical_mj.policies.interface import forever, play
from magical_mj.scene.actions import NOOP, Action, action_number, to_vector
from magical_mj.scene.bodies import GRIPPER
from magical_mj.shifts.registry import Shifts, parse_shifts, shift_label
from magical_mj.tasks.protocol import PROTOCOL
from magical_mj.tasks.registry import score, task_name, variant_name
from magical_mj.utils.errors import DemonstrationError
from magical_mj.variants import check_seed

Floats = NDArray[np.float64]

ATTEMPTS: Final = 10
REST: Final = 80
"""Steps without an action after which an expert's demonstration ends, if the episode does not end before."""
SHORT_REST: Final = 3
"""The same in SweepToTop: what lies there stays."""
STRIDE: Final = 1_000_003
"""The increment of the expert's seed between attempts, so that no two demonstrations use the same one."""
MAX_BYTES: Final = 100_000
"""The largest size of a recording: many times that of the longest episode."""
TOLERANCE: Final = 1e-3
"""The difference (world units or radians) between the end of a replay and what the player saw that is accepted."""


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

        Args:
            demonstrator: who acted.
            seed: the expert's; None: the scene's.

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
            score=score(task, env.initial_scene, env.scene),
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
            for _ in play(recorder, forever(expert)):
                if recorder.idle(SHORT_REST if env.setup.speeds else REST):
                    break
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
