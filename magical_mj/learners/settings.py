"""The settings of a training, with the paper's hyperparameters as defaults."""

from __future__ import annotations

from dataclasses import dataclass, field, is_dataclass
from math import inf
from numbers import Real
from typing import Any, Final, get_type_hints

from magical_mj.envs.presets import PRESETS, preset_named
from magical_mj.tasks.registry import TASKS, listed, task_spec
from magical_mj.utils.errors import SettingsError, check_name, shown
from magical_mj.utils.settings import LARGEST_SETTING

STATE: Final = "State"
"""The preset of the state track."""
LEARNABLE: Final = (*(name for name, made in PRESETS.items() if made.layout == "hwc"), STATE)
"""The presets that learners can look at: one stack of frames, the channels last, or states."""
AUGMENT: Final = ("all", "none", "no-trans-rot")
"""The sets of augmentations, of pictures and of states."""
HEADS: Final = 4
"""Of the attention between blocks and regions, which share the units of `Network.entity`."""
ALL_PARTS: Final = ("network", "bc", "ppo", "discriminator", "features")
"""The tables of settings below."""
SEEDS: Final = 2**63
"""Seeds are below this: half of what PyTorch's generators take, since some of them get a little more than the seed."""


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

    def __post_init__(self) -> None:
        """Raises a `SettingsError` for sizes that cannot be."""
        _check_values(self, "network.")
        if self.first_kernel % 2 == 0:
            raise SettingsError(f"network.first_kernel must be odd, not {self.first_kernel}")
        if self.entity % HEADS:
            raise SettingsError(f"network.entity must be a multiple of {HEADS}, not {self.entity}")


@dataclass(frozen=True)
class Cloning:
    """Behavioural cloning (appendix, table "Hyperparameters for BC experiments")."""

    batches: int = 20_000
    batch_size: int = 32
    optimizer: str = "sgd"
    learning_rate: float = 1e-3  # at first; from batch to batch it moves linearly to
    final_learning_rate: float = 1e-3  # at the end
    momentum: float = 0.1  # of SGD
    heads: str = "normal"  # how their first weights are drawn, normal or uniform: see `Heads`


@dataclass(frozen=True)
class PPO:
    """The policy's side of GAIL, WGAIL-GP and AL (appendix, table "Hyperparameters for GAIL experiments")."""

    total_steps: int = 1_000_000  # environment steps
    worlds: str = "single"  # that are played in: each in MuJoCo by itself, or "batched" on an accelerator
    environments: int = 32
    steps: int = 8  # in each environment, between two updates
    epochs: int = 12
    minibatch: int = 64
    learning_rate: float = 6e-5  # of Adam at first; it falls linearly to 0
    discount: float = 0.8
    gae_lambda: float = 0.8
    entropy: float = 1e-5
    clip: float = 0.01
    anneal_clip: bool = True  # it falls to 0 with the learning rate; not in the paper, but in its library, rlpyt
    normalise_advantages: bool = False  # in each minibatch; rlpyt does not
    gradient_norm: float = 1.0
    averaging: float = 0.0  # the share that each update leaves of the policies' moving average, which is evaluated
    reward_deviation: float = 0.1  # standard deviation to which rewards are normalised


@dataclass(frozen=True)
class Discriminator:
    """The discriminator's side of GAIL and WGAIL-GP (the same table)."""

    steps: int = 12  # for each update of the policy
    rollouts: int = 1  # the latest ones, from which the policy's samples are drawn; 4 in the released code
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
    samples: int = 512  # the latest of the policy, for the weight vector


@dataclass(frozen=True)
class TrainingSettings:
    """One training run, completely.

    Attributes:
        method: one of `magical_mj.learners.METHODS`, or the name of a method of the user's own.
        tasks: of the demonstrations; more than one is multi-task learning.
        seed: decides everything that is drawn: the demonstrations, the weights, the batches.
        demonstrations: how many of each task's are drawn.
        preset: what is looked at, one of `LEARNABLE`.
        augment: one of `AUGMENT`, for BC's policy and the discriminator.
        device: "auto", "cpu", or another device's name in PyTorch, such as "cuda".
        evaluations: how often during the training the policy is evaluated on the demo variant.
        episodes: in each of these evaluations, for each task.
        checkpoints: how often during the training everything is saved.
        precision: "float32", or "bfloat16" for most of what BC's network computes in training.
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
    precision: str = "float32"
    network: Network = field(default_factory=Network)
    bc: Cloning = field(default_factory=Cloning)
    ppo: PPO = field(default_factory=PPO)
    discriminator: Discriminator = field(default_factory=Discriminator)
    features: Features = field(default_factory=Features)

    def __post_init__(self) -> None:
        """Raises a `SettingsError` or an `UnknownNameError` for invalid settings."""
        if not isinstance(self.method, str) or not isinstance(self.tasks, tuple):
            found = shown((self.method, self.tasks))
            raise SettingsError(f"the method must be a name and the tasks a tuple of names, not {found}")
        for task in self.tasks:
            task_spec(task)  # or its error
        if not self.tasks or len(set(self.tasks)) < len(self.tasks):
            raise SettingsError(f"give one or several different tasks, not {list(self.tasks)}")
        preset_named(self.preset)
        if self.preset not in LEARNABLE:
            raise SettingsError(
                f"learners look at one stack of frames or at states: preset must be one of {', '.join(LEARNABLE)}"
            )
        check_name("augmentation", self.augment, AUGMENT)
        _check_values(self, "")
        if self.seed >= SEEDS:
            raise SettingsError(f"a training's seed must be below 2**63, not {shown(self.seed)}")
        for name, (value, allowed) in {
            "bc.optimizer": (self.bc.optimizer, ("sgd", "adam")),
            "bc.heads": (self.bc.heads, ("normal", "uniform")),
            "ppo.worlds": (self.ppo.worlds, ("single", "batched")),
            "precision": (self.precision, ("float32", "bfloat16")),
        }.items():
            if value not in allowed:
                raise SettingsError(f"{name} must be {' or '.join(allowed)}, not {value!r}")
        if self.bc.optimizer == "adam" and self.bc.momentum != Cloning.momentum:
            raise SettingsError("bc.momentum is of bc.optimizer=sgd: with adam, it would have no effect")
        if self.bc.final_learning_rate > self.bc.learning_rate:
            raise SettingsError(
                f"learning rates fall: bc.final_learning_rate={self.bc.final_learning_rate} must be at most "
                f"bc.learning_rate={self.bc.learning_rate}; set both"
            )
        if self.method == "bc" and self.ppo.worlds != "single":
            raise SettingsError("bc learns without playing: worlds are chosen for gail, wgail-gp and al")
        if self.method in ("gail", "wgail-gp", "al"):
            self.check_reinforcement()

    @property
    def states(self) -> bool:
        """Whether states are looked at, and not pictures."""
        return self.preset == STATE

    def check_reinforcement(self) -> None:
        """Raises a `SettingsError` if no method that plays can use the settings of `ppo` together."""
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
        if ppo.averaging >= 1:
            raise SettingsError("with ppo.averaging of 1 or more, the policy that plays in evaluations would not learn")
        if self.discriminator.batch_size % 2:
            raise SettingsError("half of discriminator.batch_size are the policy's samples: it must be even")
        if self.features.samples < tasks:
            raise SettingsError(
                f"features.samples={self.features.samples} must be at least one for each of {tasks} tasks"
            )


MAY_BE_ZERO: Final = {
    "seed", "evaluations",
    "bc.momentum", "ppo.discount", "ppo.gae_lambda", "ppo.entropy", "ppo.averaging",
    "discriminator.gradient_penalty",
}  # fmt: skip


AT_MOST: Final = {
    "episodes": LARGEST_SETTING,
    "network.first_kernel": 95, "network.first_stride": 95,  # the pictures have 96 pixels
    "network.first_channels": 4096, "network.channels": 4096, "network.hidden": 4096,
    "network.entity": 1024, "network.attention": 32,
    "bc.batch_size": 2**16,
    "ppo.environments": 2**16, "ppo.steps": 2**16, "ppo.minibatch": 2**16,
    "discriminator.batch_size": 2**16, "discriminator.rollouts": 2**10,
    "features.batch_size": 2**16, "features.size": 4096, "features.samples": 2**20,
}  # fmt: skip
"""Sizes for which no machine has the memory, or nobody the time, are above these."""


def _check_values(part: Any, prefix: str) -> None:
    """Raises a `SettingsError` for values of the wrong kind or size; numpy's numbers become Python's."""
    for field_name, kind in get_type_hints(type(part)).items():
        value, name = getattr(part, field_name), f"{prefix}{field_name}"
        if isinstance(kind, type) and is_dataclass(kind):
            if not isinstance(value, kind):
                raise SettingsError(f"{name} must be of the type {kind.__name__}, not {shown(value)}")
            _check_values(value, f"{name}.")
            continue
        value = fitting(name, value, kind)
        object.__setattr__(part, field_name, value)
        if isinstance(value, int | float) and not isinstance(value, bool):
            if not (0 < value < inf or (value == 0 and name in MAY_BE_ZERO)):
                least = "0 or more" if name in MAY_BE_ZERO else "positive"
                raise SettingsError(f"{name} must be {least}, not {shown(value)}")
            if value > AT_MOST.get(name, inf):
                raise SettingsError(f"{name} must be at most {AT_MOST[name]}, not {shown(value)}")


def fitting(name: str, value: Any, kind: Any) -> Any:
    """A value of the kind that a setting has: text is converted. Raises a `SettingsError` for what does not fit."""
    if kind == tuple[str, ...]:
        return tuple(listed(value, TASKS))
    if kind is str and isinstance(value, str):
        return value
    if kind is bool or kind is str:
        made = {"true": True, "false": False}.get(str(value).lower()) if kind is bool else None
        if made is None:
            raise SettingsError(f"{name} must be {'true or false' if kind is bool else 'text'}, not {value!r}")
        return made
    try:
        made = kind(value) if isinstance(value, str | Real) and not isinstance(value, bool) else None
    except (ValueError, OverflowError):
        made = None
    if made is None or (kind is int and isinstance(value, Real) and made != value):
        raise SettingsError(f"{name} must be a number ({kind.__name__}), not {shown(value)}")
    return made
