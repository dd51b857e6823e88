"""What policies are, what they are told of an episode, how one is played, whose errors are whose; built-in agents."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from magical_mj.scene.actions import ACTIONS, NOOP
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import InvalidActionError, RenderingError, SettingsError, ShiftError, TaskError, short_repr
from magical_mj.utils.imports import place

if TYPE_CHECKING:
    from magical_mj.engine import Engine

Action = TypeVar("Action")
Act = Callable[[Any], Any]
"""A policy, or a plain function from observation to action."""

REASON_LENGTH: Final = 300
"""The number of characters of an error that results show."""
LETTERS: Final = "abcdefghijklmnopqr"
"""One letter for each of the 18 actions: the actions of an episode are stored as a string."""
HISTORY: Final = 4
"""States in an observation, as many as there are frames in the paper's pictures."""


@dataclass(frozen=True)
class Episode:
    """The information that a policy gets at the start of an episode.

    Attributes:
        task: the task's name; of a task that is like another one, that one's: see `told_task`.
        variant: the variant's name.
        seed: the scene's seed: the episode starts in `sample_scene(task, variant, seed)`.
        run: the number of the policy among several runs of a method.
        instruction: the sentence that says what is to be done, as the shifts of the episode make it; "" before it is
            played.
        env: the engine of the environment, for policies with `uses_simulation = True`; None for all others.
    """

    task: str
    variant: str
    seed: int
    run: int = 0
    instruction: str = ""
    env: Engine | None = None

    def rng(self) -> np.random.Generator:
        """A random generator for the policy; it depends only on the task, the variant, the seed and the run."""
        return np.random.default_rng([self.run, self.seed, zlib.crc32(f"{self.task}-{self.variant}".encode())])


def told_task(task: str, like: str = "") -> str:
    """The task that policies are told: the task itself, or the one that it is like, by its definition or by `like`."""
    return like or task_spec(task).like or task


class Policy(Protocol):
    """An agent. A plain function from observation to action is accepted too.

    A class attribute `uses_simulation = True` means that the policy does not use observations: none are made, which is
    much faster, and `reset` gets the environment instead. `uses_instruction = True` means that it reads the sentence
    that says what is to be done, `episode.instruction`: observations that are dicts then hold it, too, as
    "instruction", and the policy can be evaluated under the shift "words". Attributes `preset`, `tasks` and
    `observation_shapes` (a list of those that it accepts, with None for any size) say what it was trained on;
    evaluations of anything else raise an error.
    """

    def reset(self, episode: Episode) -> None:
        """Called before each episode. No state may be carried over from one episode to the next."""

    def __call__(self, observation: Any, /) -> Any:
        """The action, an integer in 0..17, for an observation of the preset."""


@runtime_checkable
class BatchPolicy(Protocol):
    """An agent that acts in several episodes at once; used with vector environments."""

    def reset_batch(self, episodes: Sequence[Episode]) -> None:
        """Called before the episodes, which start together."""

    def act_batch(self, observations: Any) -> Sequence[Any]:
        """An action for each environment, given the stacked observations of the vector environment."""
        ...


def play_actions(env: Any, actions: Iterable[Action]) -> Iterator[tuple[Action, Any]]:
    """Takes actions in an episode that has begun, until the episode or the actions end.

    Args:
        env: an engine, or an environment with the `step` of Gymnasium. In a vector environment, all episodes must end
            together.
        actions: the actions. They may come from a generator, since each is requested only after the step before it
            was yielded and handled.

    Yields:
        Each action, and what the environment's step returned.
    """
    for action in actions:
        result = env.step(action)
        yield action, result
        if is_over(result):
            return


def is_over(result: Any) -> bool:
    """Whether the step of an engine or of an environment, which returned `result`, was the last one of its episode."""
    if isinstance(result, bool):  # of an engine
        return result
    _, _, terminated, truncated, _ = result
    return bool(np.any(terminated) or np.any(truncated))


def begin(policy: Callable[[Any], Any], episode: Episode) -> None:
    """Calls the policy's `reset`, if it has one, or else its `reset_batch`."""
    reset, reset_batch = (getattr(policy, name, None) for name in ("reset", "reset_batch"))
    if reset is not None:
        reset(episode)
    elif reset_batch is not None:
        reset_batch([episode])


def uses_simulation(policy: object) -> bool:
    """Whether the policy gets the simulation itself, and no observations."""
    return bool(getattr(policy, "uses_simulation", False))


def uses_instruction(policy: object) -> bool:
    """Whether the policy reads the sentence that says what is to be done."""
    return bool(getattr(policy, "uses_instruction", False))


def policy_name(policy: object) -> str:
    """The name of a policy that was given none: that of its function or class."""
    return getattr(policy, "__name__", type(policy).__name__)


def letters_of(actions: Iterable[int]) -> str:
    """Actions as a string, with one letter for each."""
    return "".join(LETTERS[action] for action in actions)


def actions_of(letters: str) -> list[int]:
    """The actions of a string that `letters_of` made; raises an `InvalidActionError` for any other string."""
    if not set(letters) <= set(LETTERS):
        raise InvalidActionError(
            f"stored actions are letters from {LETTERS[0]} to {LETTERS[-1]}, not {short_repr(letters)}"
        )
    return [LETTERS.index(letter) for letter in letters]


class PolicyError(Exception):
    """An error that a policy has raised, which is its cause; the text is the reason in an episode's result."""


@contextmanager
def policy_errors() -> Iterator[None]:
    """Where errors are failures of the policy, unless they say that they are not."""
    try:
        yield
    except (RenderingError, ShiftError, TaskError):
        raise
    except ImportError as error:
        raise SettingsError(f"the policy lacks a package: {reason(error, place(error, full=False))}") from error
    except (Exception, SystemExit) as error:  # a policy may raise anything
        raise PolicyError(reason(error, place(error, full=False))) from error


def reason(error: BaseException, where: str = "") -> str:
    """The error's type, message and place in one line, which can be encoded: names of files may hold other bytes."""
    try:
        message = str(error)
    except Exception:  # noqa: BLE001 a policy's exceptions may be broken, too
        message = "an error without a message"
    line = " ".join(f"{type(error).__name__}: {message}{where}".split())
    return line.encode(errors="backslashreplace").decode()[:REASON_LENGTH]


def histories(states: NDArray[np.float32]) -> NDArray[np.float32]:
    """The latest states at each step, (steps, HISTORY, names), of states (steps, names); the first one is repeated."""
    steps = np.arange(len(states))[:, None] + np.arange(1 - HISTORY, 1)
    return states[np.maximum(steps, 0)]


class History:
    """Keeps the latest HISTORY states of one or several episodes."""

    def __init__(self, states: NDArray[np.float32]) -> None:
        """Episodes begin with `states`, which are repeated."""
        self.states = np.repeat(states[..., None, :], HISTORY, axis=-2)
        """Shape (..., HISTORY, names), oldest first; a new array after each change."""

    def add(self, states: NDArray[np.float32]) -> NDArray[np.float32]:
        """Takes in what came next, shape (..., names); returns `states`."""
        self.states = np.concatenate([self.states[..., 1:, :], states[..., None, :]], axis=-2)
        return self.states

    def restart(self, which: NDArray[np.bool_], states: NDArray[np.float32]) -> None:
        """Other episodes begin in some rows, `which` (n,), with their rows of `states` (n, names)."""
        self.states = np.where(which[:, None, None], states[:, None], self.states)


class NoopAgent:
    """Does nothing."""

    uses_simulation = True

    def __call__(self, _: Any) -> int:
        """An action; the observation does not matter."""
        return NOOP


class RandomAgent:
    """Draws each action independently and uniformly."""

    uses_simulation = True

    def reset(self, episode: Episode) -> None:
        """Starts the episode's own sequence."""
        self._rng = episode.rng()

    def __call__(self, _: Any) -> int:
        """An action; the observation does not matter."""
        return int(self._rng.integers(len(ACTIONS)))


class ExpertAgent:
    """The scripted expert, which uses the state of the simulation; its seed is the number of the run."""

    uses_simulation = True
    needs_plan = True

    def reset(self, episode: Episode) -> None:
        """Makes an expert for this episode."""
        from magical_mj.policies.expert import expert_of

        if episode.env is None:
            raise SettingsError("the expert needs the simulation itself; it cannot play in vector environments")
        own = episode.env.task
        task = own if own is not None and task_spec(own).plan is not None else episode.task
        self._next = expert_of(episode.env, task, episode.run)

    def __call__(self, _: Any) -> int:
        """An action; the observation does not matter."""
        return self._next()


AGENTS: Final[Mapping[str, Callable[[], Act]]] = MappingProxyType(
    {"expert": ExpertAgent, "random": RandomAgent, "noop": NoopAgent}
)
"""The agents by name."""
