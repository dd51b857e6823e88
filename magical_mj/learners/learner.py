"""The base class of learning methods: they improve a policy by updates, and can be saved and restored."""

from __future__ import annotations

import ctypes
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Final, Literal

import torch

from magical_mj.evaluation.run import evaluate
from magical_mj.learners.data import drawn, shipped
from magical_mj.learners.networks import Actor
from magical_mj.learners.policy import TrainedPolicy, save_policy
from magical_mj.learners.settings import ALL_PARTS, STATE, TrainingSettings
from magical_mj.policies.interface import Policy
from magical_mj.utils.errors import SettingsError

UNUSABLE: Final = {"mps": "has no numbers of 64 bits", "meta": "holds no numbers"}
"""Types of devices that PyTorch knows, and why nothing can be learnt on them."""


class Method(ABC):
    """A method: how a policy comes from demonstrations.

    `magical_mj.learners.train` calls `update` as often as `updates` says, logs what it returns, evaluates the policy
    now and then, and saves it and its state.

    Attributes:
        settings: what it was made with.
        device: where its networks are.
        updates: how many make a training.
    """

    parts: ClassVar[tuple[str, ...]] = ALL_PARTS
    """The parts of the settings that it uses: only these are written into config.toml, and may be changed."""
    settings_type: ClassVar[type[TrainingSettings]] = TrainingSettings
    """The class of its settings: a subclass if it has settings of its own, as a part that `parts` names."""
    defaults: ClassVar[Mapping[str, Any]] = MappingProxyType({})
    """Setting -> the method's own default, instead of the paper's."""
    observes: ClassVar[Literal["states", "pictures", "either"]] = "either"
    """What it can learn from."""
    updates: int

    def __init__(self, settings: TrainingSettings) -> None:
        self.check_settings(settings)
        self.settings = settings
        self.device = device(settings.device)

    @classmethod
    def check_settings(cls, settings: TrainingSettings) -> None:
        """Raises a `SettingsError` if it cannot learn with these settings."""
        if settings.states and cls.observes == "pictures":
            raise SettingsError(f"{settings.method} learns from pictures: give a preset other than {STATE}")
        if not settings.states and cls.observes == "states":
            raise SettingsError(f"{settings.method} learns from states: give the preset {STATE}")

    @classmethod
    def check(cls, settings: TrainingSettings) -> None:
        """Checks what a training needs, on any device, without beginning it: for plans of many trainings.

        Raises:
            SettingsError, DemonstrationError, MissingExtraError: the errors with which it would begin.
        """
        cls.check_settings(settings)
        for task in settings.tasks:
            drawn(task, settings.seed, settings.demonstrations, len(shipped(task)))

    @abstractmethod
    def update(self) -> Mapping[str, float]:
        """Improves the policy; returns metrics to be logged, such as losses, always under the same names."""

    @abstractmethod
    def policy(self) -> Policy:
        """The current policy."""

    @abstractmethod
    def save_policy(self, folder: Path) -> None:
        """Writes the policy as it is now into a run's folder, where evaluations find it."""

    @abstractmethod
    def get_state(self) -> dict[str, Any]:
        """Everything on which later updates depend: nested dicts and lists of tensors, arrays and plain values."""

    @abstractmethod
    def set_state(self, state: dict[str, Any]) -> None:
        """Goes back to a state that `get_state` returned."""

    def fault(self) -> str | None:
        """Why what was learnt is useless, such as a weight that is not finite; None if it is not."""
        return None

    def recalibrate(self) -> None:  # noqa: B027  (of the policies, only BC's on pictures has batch norm)
        """Called before the policy is evaluated: updates running averages that lag behind the weights."""

    def demo_scores(self, episodes: int) -> dict[str, float]:
        """The policy's mean score in the demo scene, for each task."""
        settings = self.settings
        asked = {"tasks": settings.tasks, "preset": settings.preset, "renderer": settings.renderer}
        frame = evaluate(self.policy(), variants="Demo", split="dev", jobs=1, episodes=episodes, **asked)
        return {str(task): float(score) for task, score in frame.groupby("task")["score"].mean().items()}

    def close(self) -> None:  # noqa: B027  (most hold nothing)
        """Frees resources such as environments."""


class Learner(Method):
    """A method whose policy is a network.

    Attributes:
        stateful: all on which later updates depend, by name: modules, optimizers, generators and the like.
    """

    def __init__(self, settings: TrainingSettings) -> None:
        super().__init__(settings)
        self.stateful: dict[str, Any] = {}

    @property
    @abstractmethod
    def actor(self) -> Actor:
        """The policy that is evaluated and saved; updated in place."""

    def policy(self) -> TrainedPolicy:
        """Draws from what the network holds probable."""
        return TrainedPolicy(self.actor, self.settings.tasks, self.settings.preset)

    def save_policy(self, folder: Path) -> None:
        """Writes the network."""
        save_policy(folder, self.actor, self.settings)

    def get_state(self) -> dict[str, Any]:
        """The states of all that is `stateful`."""
        parts = self.stateful.items()
        return {name: part.state_dict() if hasattr(part, "state_dict") else part.get_state() for name, part in parts}

    def set_state(self, state: dict[str, Any]) -> None:
        """Goes back to a state that `get_state` returned."""
        for name, part in self.stateful.items():
            if isinstance(part, torch.optim.Optimizer):
                restore_optimizer(part, state[name])
            elif hasattr(part, "state_dict"):
                part.load_state_dict(state[name])
            else:
                part.set_state(state[name])

    def fault(self) -> str | None:
        """Whether a weight, or an average of batch norm, is not finite."""
        finite = all(values.isfinite().all() for values in self.actor.state_dict().values())
        return None if finite else "a weight is not finite any more"


def device(name: str) -> torch.device:
    """The device of that name, for "auto" an accelerator if there is one; raises a `SettingsError` if there is none."""
    if name == "auto":
        accelerator = torch.accelerator.current_accelerator(check_available=True)
        return torch.device("cpu") if accelerator is None or accelerator.type in UNUSABLE else accelerator
    try:
        named = torch.zeros(1, device=name).device
    except (RuntimeError, AssertionError) as error:
        raise SettingsError(
            f"there is no device {name!r} here: {str(error).splitlines()[0]}; cpu always works"
        ) from error
    if named.type in UNUSABLE:
        raise SettingsError(f"{name!r} {UNUSABLE[named.type]}; cpu always works")
    return named


def keep_freed_memory() -> None:
    """Makes glibc keep freed memory (with other C libraries it does nothing).

    Training frees and allocates blocks of many megabytes in every batch. By default these are returned to the system,
    which must clear them again: a quick BC step would take 1.7 times as long. Raising the size above which a block is
    returned would not do: glibc allows 32 MiB at most, and a batch of the full network needs 72 MiB at once.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # no such library
        return
    for parameter, value in ((-1, 2**31 - 1), (-2, 2**26), (-4, 0)):  # trim threshold, top pad, mmap's maximum
        mallopt(parameter, value)


def threads_for(settings: TrainingSettings, begun: int | None = None) -> int:
    """The number of PyTorch's threads for a training: one for states; else as many as it was begun with, if it was.

    With another number, sums are rounded differently. The networks for states are so small that a second thread gains
    a tenth on idle cores. On busy cores, threads wait for each other: with two, BC did 1.4 batches per second, and with
    one 106.
    """
    return 1 if settings.states else begun or torch.get_num_threads()


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """A context in which PyTorch's global generators have this seed; afterwards, their states are restored."""
    with torch.random.fork_rng(devices=range(torch.cuda.device_count())):
        torch.manual_seed(seed)
        yield


def restore_optimizer(optimizer: torch.optim.Optimizer, state: dict[str, Any]) -> None:
    """Restores an optimizer's state, with the same memory layout as its weights.

    With another layout, sums are rounded differently, and fused optimizers mix up the weights.
    """
    optimizer.load_state_dict(state)
    for weights, memory in optimizer.state.items():
        for name, value in memory.items():
            if isinstance(value, torch.Tensor) and value.shape == weights.shape:
                memory[name] = torch.empty_like(weights).copy_(value)
