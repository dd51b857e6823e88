"""The interface of policies, the information that they receive, their errors, and the built-in agents."""

from __future__ import annotations

import traceback
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from magical_mj.actions import ACTIONS, NOOP
from magical_mj.tasks.languages import in_language
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import InvalidActionError, RenderingError, SettingsError, ShiftError, TaskError, short_repr
from magical_mj.utils.imports import location

if TYPE_CHECKING:
    from magical_mj.engine import Engine

Action = TypeVar("Action")
Act = Callable[[Any], Any]
"""A policy, or a plain function from observation to action."""

REASON_LENGTH: Final = 300
"""The maximum number of characters of an error message in results."""
LETTERS: Final = "abcdefghijklmnopqr"
"""One letter for each of the 18 actions. The actions of an episode are stored as a string."""
HISTORY: Final = 4
"""The number of state vectors in an observation. The paper's pictures contain the same number of frames."""
USES: Final = ("observations", "simulation", "demonstrations", "instruction", "memory")
"""What a policy may use during an episode."""
NEUTRAL: Final = "intent"
"""The task name that policies receive if demonstrations or a sentence describe the task."""

Observations = NDArray[Any] | dict[str, NDArray[Any]]
"""An array with a row for each time. For presets with the layout "dict", one such array for each name."""


class Transitions(NamedTuple):
    """The observation before each action, and the action."""

    observations: Observations
    """Shape (n, ...). Rows are observations of the preset, such as (96, 96, 12) uint8 for LoRes4E."""
    actions: NDArray[Any]
    """Action numbers, shape (n,). For SweepToTop speeds, shape (n, 2 or 3)."""


@dataclass(frozen=True)
class Episode:
    """The information that a policy gets at the start of an episode.

    Attributes:
        task: the name that `policy_task` gives to the episode's task.
        variant: the variant's name.
        seed: the scene's seed. The episode starts in `sample_scene(task, variant, seed)`.
        run: the policy's number among several trainings of one method.
        instruction: the sentence that describes the task, including its shift. Before the episode starts, it is empty,
            or a sentence that replaces the task's. It remains empty if the task's name is `NEUTRAL` and the policy does
            not use instructions.
        env: the engine of the environment, for policies with `uses_simulation = True`. None for all others.
        demonstrations: demonstrations of the task, for policies with `uses_demonstrations = True`: observations of the
            policy's preset and actions, of all steps. If the policy also has `uses_simulation = True`, they are
            `magical_mj.demos.Demonstration` objects, which contain the scenes.
    """

    task: str
    variant: str
    seed: int
    run: int = 0
    instruction: str = ""
    env: Engine | None = None
    demonstrations: tuple[Transitions, ...] | tuple[Any, ...] = field(default=(), compare=False, repr=False)

    def rng(self) -> np.random.Generator:
        """A random generator for the policy, determined by task, variant, seed and run."""
        return np.random.default_rng([self.run, self.seed, zlib.crc32(f"{self.task}-{self.variant}".encode())])


def policy_task(task: str, policy: object, like: str = "") -> str:
    """The name of a task that a policy receives.

    It is the first of these that applies:

    - `like`, if it is given.
    - `NEUTRAL`, if the policy uses demonstrations, or if the task is an intent that is not among the policy's `tasks`.
    - The task that the task's definition names in `like`.
    - The task's own name.
    """
    if like:
        return like
    tasks = getattr(policy, "tasks", None) or ()
    if isinstance(tasks, str):
        tasks = (tasks,)
    is_new_intent = in_language(task) and task not in tasks
    if is_new_intent or "demonstrations" in uses_of(policy):
        return NEUTRAL
    return task_spec(task).like or task


class Policy(Protocol):
    """An agent. A plain function from observation to action is also accepted. All attributes are optional.

    Attributes:
        uses_simulation: True if the policy uses the engine instead of observations, which are not rendered then. The
            episode passed to `reset` contains the engine.
        uses_observations: False if the policy uses neither.
        uses_instruction: True if the policy reads the sentence that describes the task. Then dict observations contain
            it as "instruction", and the policy can be evaluated with the shift "words".
        uses_demonstrations: True if demonstrations describe the task, which the episode passed to `reset` contains.
            Then it contains neither the task's name nor, unless the policy also uses instructions, the sentence.
        preset, tasks, observation_shapes: the preset, the tasks and the observation shapes of its training. In a shape,
            None means any size. Evaluations that do not match them raise an error.
        learnt: what its training used, a `magical_mj.policies.facts.Learnt`. Evaluations and entries record it.
    """

    def reset(self, episode: Episode) -> None:
        """Called before each episode. No state may be carried over from one episode to the next."""

    def __call__(self, observation: Any, /) -> Any:
        """The action, an integer in 0..17, for an observation of the preset."""


@runtime_checkable
class BatchPolicy(Protocol):
    """An agent that acts in several episodes at once, in vector environments. It needs no other methods.

    The optional attributes are those of a `Policy`. If it also has `__call__` and `reset`, they play single episodes.
    """

    def reset_batch(self, episodes: Sequence[Episode]) -> None:
        """Called before the episodes. They start together."""

    def act_batch(self, observations: Any) -> Sequence[Any]:
        """An action for each environment, given the stacked observations of the vector environment."""
        ...


def play_actions(env: Any, actions: Iterable[Action]) -> Iterator[tuple[Action, Any]]:
    """Executes actions in a running episode of an engine or environment, until the episode or the actions end.

    Yields each action with the result of its step. The next action is requested only after that.
    """
    for action in actions:
        result = env.step(action)
        yield action, result
        if is_over(result):
            return


def is_over(result: Any) -> bool:
    """Whether a step with this result, of an engine or of an environment, was the last one of its episode."""
    if isinstance(result, bool):  # the result of an engine
        return result
    _, _, terminated, truncated, _ = result
    return bool(np.any(terminated) or np.any(truncated))


def begin(policy: Act | BatchPolicy, episode: Episode) -> None:
    """Starts an episode that is played alone by the policy's `reset`, or otherwise by its `reset_batch`, if it has one.

    If it has no `__call__`, it acts by `act_batch`, and therefore starts by `reset_batch`.
    """
    reset, reset_batch = getattr(policy, "reset", None), getattr(policy, "reset_batch", None)
    if reset is not None and callable(policy):
        reset(episode)
    elif reset_batch is not None:
        reset_batch([episode])


def act(policy: Act | BatchPolicy, observation: Any) -> Any:
    """The action for one observation. A policy without `__call__` receives a batch of one."""
    if isinstance(policy, BatchPolicy) and not callable(policy):
        return policy.act_batch(batch_of_one(observation))[0]
    return policy(observation)


def batch_of_one(observation: Any) -> Any:
    """An observation as vector environments return it. Dicts of observations stay dicts; texts become tuples."""
    if isinstance(observation, Mapping):
        return {name: batch_of_one(part) for name, part in observation.items()}
    return (observation,) if isinstance(observation, str) else np.asarray(observation)[None]


def uses_of(policy: object) -> frozenset[str]:
    """What a policy uses, of `USES`. It has a memory if it can be reset."""
    simulation = getattr(policy, "uses_simulation", False)
    used = {
        "simulation": simulation,
        "observations": not simulation and getattr(policy, "uses_observations", True),
        "demonstrations": getattr(policy, "uses_demonstrations", False),
        "instruction": getattr(policy, "uses_instruction", False),
        "memory": hasattr(policy, "reset") or hasattr(policy, "reset_batch"),
    }
    return frozenset(filter(used.get, USES))


def policy_name(policy: object) -> str:
    """The default name of a policy: that of its function or class."""
    return getattr(policy, "__name__", type(policy).__name__)


def letters_of(actions: Iterable[int]) -> str:
    """Actions as a string, with a letter for each."""
    return "".join(map(LETTERS.__getitem__, actions))


def actions_of(letters: str) -> list[int]:
    """The actions of a string that `letters_of` made. Raises an `InvalidActionError` for any other string."""
    if not set(letters) <= set(LETTERS):
        raise InvalidActionError(
            f"stored actions are letters from {LETTERS[0]} to {LETTERS[-1]}, not {short_repr(letters)}"
        )
    return [LETTERS.index(letter) for letter in letters]


class PolicyError(Exception):
    """A policy raised an error, which is the cause of this one. The text becomes the reason in the episode's result."""

    def __reduce__(self) -> tuple[Any, ...]:
        """For other processes: with the whole traceback as text, since the cause may not be picklable."""
        return PolicyError, ("".join(traceback.format_exception(self)),)


@contextmanager
def policy_errors() -> Iterator[None]:
    """A context for calls of a policy. Its errors become a `PolicyError`.

    Errors of the renderer, of shifts and of tasks pass through. An import error becomes a `SettingsError`.
    """
    try:
        yield
    except (RenderingError, ShiftError, TaskError):
        raise
    except ImportError as error:
        raise SettingsError(
            f"the policy needs a missing package: {reason(error, location(error, full=False))}"
        ) from error
    except (Exception, SystemExit) as error:  # a policy may raise any error
        raise PolicyError(reason(error, location(error, full=False))) from error


def reason(error: BaseException, where: str = "") -> str:
    """The error's type, message and location in one line. Characters that cannot be encoded are escaped."""
    try:
        message = str(error)
    except Exception:  # noqa: BLE001 a policy's exceptions may be broken as well
        message = "an error without a message"
    line = " ".join(f"{type(error).__name__}: {message}{where}".split())
    return line.encode(errors="backslashreplace").decode()[:REASON_LENGTH]


def histories(states: NDArray[np.float32]) -> NDArray[np.float32]:
    """The latest states at each step of an episode, shape (steps, names) -> (steps, HISTORY, names), oldest first.

    Before the first step, its state is repeated.
    """
    steps = np.arange(len(states))[:, None] + np.arange(1 - HISTORY, 1)
    return states[np.maximum(steps, 0)]


class History:
    """Keeps the latest HISTORY states of one or several episodes."""

    def __init__(self, states: NDArray[np.float32]) -> None:
        """Starts episodes whose first `states` have the shape (..., names). They fill the whole history."""
        self.states = np.repeat(states[..., None, :], HISTORY, axis=-2)
        """Shape (..., HISTORY, names), oldest first. Each change creates a new array."""

    def add(self, states: NDArray[np.float32]) -> NDArray[np.float32]:
        """Adds the next states, shape (..., names). Returns `self.states`."""
        self.states = np.concatenate([self.states[..., 1:, :], states[..., None, :]], axis=-2)
        return self.states


class NoopAgent:
    """Does nothing."""

    uses_observations = False

    def __call__(self, _: Any) -> int:
        """The action that does nothing."""
        return NOOP


class RandomAgent:
    """Draws each action independently and uniformly."""

    uses_observations = False

    def reset(self, episode: Episode) -> None:
        """Creates the episode's random generator."""
        self._rng = episode.rng()

    def __call__(self, _: Any) -> int:
        """A random action."""
        return int(self._rng.integers(len(ACTIONS)))


class ExpertAgent:
    """The scripted expert, which uses the state of the simulation. Its seed is the number of the run."""

    uses_simulation = True
    needs_plan = True

    def reset(self, episode: Episode) -> None:
        """Creates an expert for this episode."""
        from magical_mj.experts import expert_of

        if episode.env is None:
            raise SettingsError("the expert uses the simulation: it cannot play in vector environments")
        own = episode.env.task
        task = own if own is not None and task_spec(own).plan is not None else episode.task
        self._expert = expert_of(episode.env, task, episode.run)

    def __call__(self, _: Any) -> int:
        """The expert's action for the current state."""
        return self._expert()


AGENTS: Final[Mapping[str, Callable[[], Act]]] = MappingProxyType(
    {"expert": ExpertAgent, "random": RandomAgent, "noop": NoopAgent}
)
"""The agents by name."""
