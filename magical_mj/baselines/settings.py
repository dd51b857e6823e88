"""Every number of a training, with the paper's values (its tables of hyperparameters) as defaults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from types import MappingProxyType
from typing import Any, Final, TypeVar, get_type_hints

from magical_mj.errors import SettingsError, unknown_name
from magical_mj.presets import PRESETS, preset
from magical_mj.registry import TASKS, listed, task_name, task_spec

STATE: Final = "State"
"""The preset of the state track."""
LEARNABLE: Final = (*(name for name, made in PRESETS.items() if made.layout == "hwc"), STATE)
"""The presets that learners can look at: one stack of frames, the channels last, or states."""


@dataclass(frozen=True)
class Network:
    """The layers that all networks share (appendix, "Network architecture")."""

    first_kernel: int = 5
    first_stride: int = 1
    first_channels: int = 64
    channels: int = 128  # of each of the four 3 x 3 convolutions of stride 2 that follow
    hidden: int = 256  # units of each of the two linear layers
    entity: int = 64  # of states: units for the robot, each block and each region
    attention: int = 1  # likewise: layers of attention between them


@dataclass(frozen=True)
class Cloning:
    """Behavioural cloning (appendix, table "Hyperparameters for BC experiments")."""

    batches: int = 20_000
    batch_size: int = 32
    optimizer: str = "sgd"
    learning_rate: float = 1e-3  # at first; from batch to batch it moves linearly to
    final_learning_rate: float = 1e-3  # at the end
    momentum: float = 0.1  # of SGD
    heads: str = "normal"  # how their first weights are drawn: see `Heads`


@dataclass(frozen=True)
class PPO:
    """The policy's side of GAIL, WGAIL-GP and AL (appendix, table "Hyperparameters for GAIL experiments")."""

    total_steps: int = 1_000_000  # environment steps
    environments: int = 32
    steps: int = 8  # in each environment, between two updates
    epochs: int = 12
    minibatch: int = 64
    learning_rate: float = 6e-5  # of Adam at first; it falls linearly to 0
    discount: float = 0.8
    gae_lambda: float = 0.8
    entropy: float = 1e-5
    clip: float = 0.01
    gradient_norm: float = 1.0
    reward_deviation: float = 0.1  # standard deviation to which rewards are normalised


@dataclass(frozen=True)
class Discriminator:
    """The discriminator's side of GAIL and WGAIL-GP (the same table)."""

    steps: int = 12  # for each update of the policy
    batch_size: int = 24  # half of them the policy's, half the expert's
    learning_rate: float = 2.5e-5  # of Adam
    gradient_penalty: float = 100.0  # of WGAIL-GP


@dataclass(frozen=True)
class Features:
    """The feature function of AL (appendix, "Apprenticeship learning baseline")."""

    batches: int = 8_192  # of the autoencoder's training
    batch_size: int = 24
    learning_rate: float = 1e-4  # of Adam; the paper does not say
    size: int = 32
    samples: int = 512  # of each side, for the weight vector


@dataclass(frozen=True)
class TrainingSettings:
    """One training run, completely.

    Attributes:
        method: one of `magical_mj.baselines.METHODS`, or the name of a method of the user's own.
        tasks: of the demonstrations; more than one is multi-task learning.
        seed: decides everything that is drawn: the demonstrations, the weights, the batches.
        demonstrations: how many of each task's are drawn.
        preset: what is looked at, one of `LEARNABLE`.
        augment: one of `magical_mj.baselines.augmentation.AUGMENTATIONS`, for BC's policy and the discriminator.
        device: "auto", "cpu", or another device's name in PyTorch, such as "cuda".
        evaluations: how often during the training the policy is evaluated on the demo variant.
        episodes: in each of these evaluations, for each task.
        checkpoints: how often during the training everything is saved.
    """

    method: str
    tasks: tuple[str, ...]
    seed: int = 0
    demonstrations: int = 10
    preset: str = "LoRes4E"
    augment: str = "all"
    device: str = "auto"
    evaluations: int = 10
    episodes: int = 10
    checkpoints: int = 50
    network: Network = field(default_factory=Network)
    bc: Cloning = field(default_factory=Cloning)
    ppo: PPO = field(default_factory=PPO)
    discriminator: Discriminator = field(default_factory=Discriminator)
    features: Features = field(default_factory=Features)

    def __post_init__(self) -> None:
        """Raises a `SettingsError` or an `UnknownNameError` for what cannot be."""
        for task in self.tasks:
            task_spec(task)  # or its error
        if not self.tasks or len(set(self.tasks)) < len(self.tasks):
            raise SettingsError(f"give one or several different tasks, not {list(self.tasks)}")
        preset(self.preset)
        if self.preset not in LEARNABLE:
            raise SettingsError(
                f"learners look at one stack of frames or at states: preset must be one of {', '.join(LEARNABLE)}"
            )
        _check_positive(self, "")
        if self.bc.final_learning_rate > self.bc.learning_rate:
            raise SettingsError("learning rates fall: bc.final_learning_rate must be at most bc.learning_rate")
        if self.method != "bc":
            self._check_reinforcement()

    @property
    def states(self) -> bool:
        """Whether states are looked at, and not pictures."""
        return self.preset == STATE

    def _check_reinforcement(self) -> None:
        """Of all methods but BC, whatever the user's own may be: most of them play."""
        ppo, tasks = self.ppo, len(self.tasks)
        rollout = ppo.environments * ppo.steps
        if ppo.environments % tasks:
            raise SettingsError(
                f"environments are split evenly between tasks: ppo.environments={ppo.environments} "
                f"must be a multiple of {tasks}"
            )
        if ppo.minibatch == 1 or rollout % ppo.minibatch:
            raise SettingsError(
                f"minibatches must be of the same size, and of more than one sample: ppo.minibatch={ppo.minibatch} "
                f"does not divide ppo.environments x ppo.steps = {rollout}"
            )
        if ppo.total_steps < rollout:
            raise SettingsError(f"ppo.total_steps={ppo.total_steps} are too few for one rollout of {rollout} steps")
        if max(ppo.discount, ppo.gae_lambda) > 1:
            raise SettingsError("ppo.discount and ppo.gae_lambda must be at most 1")
        if self.discriminator.batch_size % 2:
            raise SettingsError("half of discriminator.batch_size are the policy's samples: it must be even")
        if self.features.samples < tasks:
            raise SettingsError(
                f"features.samples={self.features.samples} must be at least one for each of {tasks} tasks"
            )


MAY_BE_ZERO: Final = {
    "seed", "evaluations",
    "bc.momentum", "ppo.discount", "ppo.gae_lambda", "ppo.entropy", "discriminator.gradient_penalty",
}  # fmt: skip

QUICK: Final[Mapping[str, Any]] = MappingProxyType(
    {
        "network.first_stride": 4,
        "network.first_channels": 32,
        "network.channels": 64,
        "bc.batches": 4_000,
        "bc.optimizer": "adam",
        "bc.final_learning_rate": 1e-5,  # batch norm's averages must catch up with weights that Adam moves fast
        "ppo.total_steps": 80_000,
        "ppo.steps": 16,
        "ppo.epochs": 4,
        "ppo.learning_rate": 3e-4,
        "ppo.discount": 0.9,
        "ppo.entropy": 0.003,
        "ppo.clip": 0.2,
        "discriminator.steps": 6,
        "discriminator.batch_size": 32,
        "discriminator.learning_rate": 1e-4,
        "features.batches": 1_000,
        "features.learning_rate": 1e-3,
    }
)
"""What `quick` changes: a smaller network and shorter training, for two cores without an accelerator."""

STATE_TRACK: Final[Mapping[str, Any]] = MappingProxyType(
    {
        "bc.batches": 2_000,
        "bc.batch_size": 128,
        "bc.optimizer": "adam",
        "bc.final_learning_rate": 1e-5,
        "bc.heads": "uniform",
        "ppo.total_steps": 300_000,
        "ppo.steps": 16,
        "ppo.epochs": 4,
        "ppo.minibatch": 128,
        "ppo.learning_rate": 3e-4,
        "ppo.discount": 0.9,
        "ppo.entropy": 0.003,
        "ppo.clip": 0.2,
        "discriminator.steps": 6,
        "discriminator.batch_size": 128,
        "discriminator.learning_rate": 1e-4,
        "features.batches": 1_000,
        "features.learning_rate": 1e-3,
    }
)
"""What the preset State changes: the paper has no such track."""

T = TypeVar("T")


def load_settings(
    method: str, tasks: str | tuple[str, ...], *, quick: bool = False, **changes: Any
) -> TrainingSettings:
    """The settings of a method: the paper's, those of `quick`, and then the `changes`.

    Args:
        method: one of `magical_mj.baselines.METHODS`, or the name of a method of the user's own.
        tasks: the tasks, as a tuple or separated by commas; "all" is all eight.
        quick: use a smaller network and a shorter training on pictures.
        changes: by field; those of parts with dots, as in ``**{"ppo.clip": 0.02}``.
    """
    if isinstance(tasks, str):
        tasks = tuple(task_name(task) for task in listed(tasks, TASKS))
    if changes.get("preset") == STATE:
        if quick:
            raise SettingsError("quick is for pictures: learning from states is quick as it is")
        changes = {**STATE_TRACK, **changes}
    return changed(TrainingSettings(method, tasks), {**(QUICK if quick else {}), **changes})


def changed(settings: TrainingSettings, changes: Mapping[str, Any]) -> TrainingSettings:
    """The settings with other values; values given as text are read as what the field holds.

    Raises:
        UnknownNameError: if there is no such field.
        SettingsError: if a value does not fit.
    """
    known = names(settings)
    for name in changes:
        if name not in known:
            raise unknown_name("setting", name, known)
    return _changed(settings, changes, "")


def _changed(part: T, changes: Mapping[str, Any], prefix: str) -> T:
    values = {}
    for name, kind in get_type_hints(type(part)).items():
        path = prefix + name
        if is_dataclass(kind):
            values[name] = _changed(getattr(part, name), changes, f"{path}.")
        elif path in changes:
            values[name] = _fitting(path, changes[path], kind)
    return replace(part, **values)  # pyright: ignore[reportArgumentType]


def names(settings: Any, prefix: str = "") -> list[str]:
    """The names of all fields, those of parts with dots."""
    found = []
    for item in fields(settings):
        value = getattr(settings, item.name)
        found += names(value, f"{prefix}{item.name}.") if is_dataclass(value) else [f"{prefix}{item.name}"]
    return found


def _fitting(name: str, value: Any, kind: Any) -> Any:
    if kind == tuple[str, ...]:
        return tuple(value.split(",")) if isinstance(value, str) else tuple(value)
    try:
        made = kind(value)
    except (TypeError, ValueError):
        made = None
    if made is None or isinstance(value, bool) or (kind is int and isinstance(value, float) and made != value):
        raise SettingsError(f"{name} must be a number ({kind.__name__}), not {value!r}")
    return made


def _check_positive(part: Any, prefix: str) -> None:
    for item in fields(part):
        value, name = getattr(part, item.name), f"{prefix}{item.name}"
        if is_dataclass(value):
            _check_positive(value, f"{name}.")
        elif isinstance(value, int | float) and not (value > 0 or (value == 0 and name in MAY_BE_ZERO)):
            raise SettingsError(f"{name} must be {'0 or more' if name in MAY_BE_ZERO else 'positive'}, not {value}")
