"""The base classes of learning methods. A method improves a policy by updates, and can be saved and restored."""

from __future__ import annotations

import ctypes
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Final, Literal

import torch
from torch import Tensor

from magical_mj.evaluation.run import evaluate
from magical_mj.learners.data import chosen
from magical_mj.learners.networks import Actor
from magical_mj.learners.policy import TrainedPolicy, save_policy
from magical_mj.learners.settings import ALL_PARTS, STATE, PPOSettings, TrainingSettings
from magical_mj.policies.facts import Learnt
from magical_mj.policies.interface import Policy
from magical_mj.utils.errors import SettingsError

UNUSABLE: Final = {"mps": "has no 64-bit numbers", "meta": "stores no values"}
"""PyTorch's device types that cannot be used for training, with the reason."""


class Method(ABC):
    """A learning method: it learns a policy from demonstrations.

    `magical_mj.learners.train` calls `update` `updates` times and logs the metrics that it returns. In between it
    evaluates the policy, and saves it with the method's state.

    Attributes:
        settings: the settings of the training.
        device: the device of its networks.
        updates: the number of updates of a training.
    """

    parts: ClassVar[tuple[str, ...]] = ALL_PARTS
    """The parts of the settings that it uses. Only these are written to config.toml and may be changed."""
    settings_type: ClassVar[type[TrainingSettings]] = TrainingSettings
    """The class of its settings: a subclass if it has its own settings, as a part that is listed in `parts`."""
    unused: ClassVar[tuple[str, ...]] = ()
    """Settings that have no effect, although they are in these parts, or in no part."""
    defaults: ClassVar[Mapping[str, Any]] = MappingProxyType({})
    """Setting -> the method's own default, instead of the paper's."""
    short: ClassVar[Mapping[str, Any]] = MappingProxyType({})
    """Setting -> the method's own default in short trainings, instead of that of `config.QUICK` or `STATE_TRACK`."""
    observes: ClassVar[Literal["states", "pictures", "either"]] = "either"
    """The supported observations."""
    learns_reward: ClassVar[bool] = False
    """Whether it learns a reward, and implements `learnt_reward`."""
    updates: int

    def __init__(self, settings: TrainingSettings) -> None:
        self.check_settings(settings)
        self.settings = settings
        self.device = device(settings.device)

    @classmethod
    def check_values(cls, settings: TrainingSettings) -> None:
        """Raises a `SettingsError` if values do not fit together. Called when settings are created; reads no files."""
        if "ppo" not in cls.parts and settings.ppo.simulator != PPOSettings.simulator:
            raise SettingsError(f"{settings.method} cannot choose its simulator: it plays no episodes")

    @classmethod
    def check_settings(cls, settings: TrainingSettings) -> None:
        """Raises a `SettingsError` if the method does not support these settings, or a file in them."""
        cls.check_values(settings)
        if cls.observes not in ("either", "states" if settings.states else "pictures"):
            preset = f"the preset {STATE}" if cls.observes == "states" else f"a preset other than {STATE}"
            raise SettingsError(f"{settings.method} learns from {cls.observes}: give {preset}")

    @classmethod
    def check(cls, settings: TrainingSettings) -> None:
        """Checks the requirements of a training without starting it, for plans of experiments. Ignores the device.

        Raises:
            SettingsError, DemonstrationError, MissingExtraError: the errors of the start of a training.
        """
        cls.check_settings(settings)
        for task in settings.tasks:
            chosen(settings, task)

    @property
    def learnt(self) -> Learnt:
        """What the training uses."""
        return Learnt(self.settings.demos.set, self.settings.reward.variant)

    @abstractmethod
    def update(self) -> Mapping[str, float]:
        """Improves the policy; returns metrics to be logged, such as losses, always under the same names."""

    @abstractmethod
    def policy(self) -> Policy:
        """The current policy."""

    @abstractmethod
    def save_policy(self, folder: Path) -> None:
        """Writes the current policy into a run's folder, from where evaluations load it."""

    @abstractmethod
    def get_state(self) -> dict[str, Any]:
        """The state that determines later updates, as nested dicts and lists of tensors, arrays and plain values."""

    @abstractmethod
    def set_state(self, state: dict[str, Any]) -> None:
        """Restores a state from `get_state`."""

    def learnt_reward(self, observations: Tensor, following: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        """The learnt rewards (n,) of steps, before normalisation.

        Args:
            observations: the observations before the actions, from `networks.as_input`.
            following: those after the actions.
            actions: shape (n,).
            tasks: the numbers of the tasks, shape (n,).
        """
        del observations, following, actions, tasks
        raise SettingsError(f"{self.settings.method} does not learn a reward")

    def fault(self) -> str | None:
        """The reason why the policy is unusable, such as a weight that is not finite. None if it is usable."""
        return None

    def recalibrate(self) -> None:  # noqa: B027  (only BC's policy on pictures has batch norm)
        """Called before the policy is evaluated: updates running averages that lag behind the weights."""

    def demo_scores(self, episodes: int) -> dict[str, float]:
        """The policy's mean score in the demo scene, for each task."""
        settings = self.settings
        asked = {"tasks": settings.tasks, "preset": settings.preset, "renderer": settings.renderer}
        frame = evaluate(self.policy(), variants="Demo", split="dev", jobs=1, episodes=episodes, **asked)
        return {str(task): float(score) for task, score in frame.groupby("task")["score"].mean().items()}

    def close(self) -> None:  # noqa: B027  (most methods have no resources)
        """Frees resources such as environments."""


class Learner(Method):
    """A method whose policy is a network.

    Attributes:
        actor: the policy that is evaluated and saved. It is updated in place.
        stateful: name -> object, for all objects that determine later updates: modules, optimizers, generators.
    """

    actor: Actor

    def __init__(self, settings: TrainingSettings) -> None:
        super().__init__(settings)
        self.stateful: dict[str, Any] = {}

    def policy(self) -> TrainedPolicy:
        """The policy that draws actions from the network's probabilities."""
        return TrainedPolicy(self.actor, self.settings.tasks, self.settings.preset, self.learnt)

    def save_policy(self, folder: Path) -> None:
        """Writes the network."""
        save_policy(folder, self.actor, self.settings)

    def get_state(self) -> dict[str, Any]:
        """The states of all objects in `stateful`."""
        parts = self.stateful.items()
        return {name: part.state_dict() if hasattr(part, "state_dict") else part.get_state() for name, part in parts}

    def set_state(self, state: dict[str, Any]) -> None:
        """Restores a state from `get_state`."""
        for name, part in self.stateful.items():
            if isinstance(part, torch.optim.Optimizer):
                restore_optimizer(part, state[name])
            elif hasattr(part, "state_dict"):
                part.load_state_dict(state[name])
            else:
                part.set_state(state[name])

    def fault(self) -> str | None:
        """A message if a weight, or an average of batch norm, is not finite."""
        finite = all(values.isfinite().all() for values in self.actor.state_dict().values())
        return None if finite else "a weight is no longer finite"


def device(name: str) -> torch.device:
    """The device of that name; "auto": an accelerator, or the CPU. Raises a `SettingsError` if it does not exist."""
    if name == "auto":
        accelerator = torch.accelerator.current_accelerator(check_available=True)
        return torch.device("cpu") if accelerator is None or accelerator.type in UNUSABLE else accelerator
    try:
        named = torch.zeros(1, device=name).device
    except (RuntimeError, AssertionError) as error:
        raise SettingsError(f"this machine has no device {name!r}: {str(error).splitlines()[0]}; use cpu") from error
    if named.type in UNUSABLE:
        raise SettingsError(f"the device {name!r} {UNUSABLE[named.type]}; use cpu")
    return named


def keep_freed_memory() -> None:
    """Makes glibc keep freed memory. With other C libraries it does nothing.

    Training frees and allocates blocks of many megabytes in every batch. By default these are returned to the system,
    which must clear them again: a quick BC step would take 1.7 times as long.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # another C library
        return
    for parameter, value in ((-1, 2**31 - 1), (-2, 2**26), (-4, 0)):  # trim threshold, top pad, mmap's maximum
        mallopt(parameter, value)


def threads_for(settings: TrainingSettings, begun: int | None = None) -> int:
    """The number of PyTorch's threads for a training: one for states; otherwise `begun`, or PyTorch's default.

    With another number of threads, sums are rounded differently. The networks for states are so small that threads
    gain little, and on busy cores they wait for each other.
    """
    return 1 if settings.states else begun or torch.get_num_threads()


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Gives PyTorch's global generators this seed within a context. At its end, their states are restored."""
    with torch.random.fork_rng(devices=range(torch.cuda.device_count())):
        torch.manual_seed(seed)
        yield


def restore_optimizer(optimizer: torch.optim.Optimizer, state: dict[str, Any]) -> None:
    """Restores an optimizer's state, with the same memory layout as its weights.

    With another layout, sums are rounded differently, and fused optimizers assign values to the wrong weights.
    """
    optimizer.load_state_dict(state)
    for weights, memory in optimizer.state.items():
        for name, value in memory.items():
            if isinstance(value, torch.Tensor) and value.shape == weights.shape:
                memory[name] = torch.empty_like(weights).copy_(value)
