"""The learning methods by name, and the settings of a training, whose defaults are the paper's hyperparameters.

The classes of methods are imported at their first use.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cache
from importlib.metadata import EntryPoint
from types import MappingProxyType
from typing import Annotated, Any, Final, Literal

from msgspec import Meta

from magical_mj.envs.presets import PRESETS, preset_named
from magical_mj.rendering.backend import RendererName
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import SettingsError
from magical_mj.utils.extras import check_extra
from magical_mj.utils.imports import announced, imported, resolve_installed
from magical_mj.utils.settings import Count, Natural, Settings

METHOD_GROUP: Final = "magical_mj.methods"
"""The entry-point group for methods of installed packages, such as ``mine = "package.module:Mine"``."""
OWN: Final[Mapping[str, str]] = MappingProxyType(
    {
        "bc": "bc:BehaviouralCloning",
        "gail": "gail:GAIL",
        "wgail-gp": "gail:WGAILGP",
        "airl": "gail:AIRL",
        "al": "apprenticeship:Apprenticeship",
        "iq-learn": "bc:IQLearn",
        "point": "bc:Point",
        "ppo": "rewards:OnLearntReward",
    }
)
"""The methods of this package: name -> module and class."""


@cache
def announced_methods() -> Mapping[str, EntryPoint]:
    """The entry points of methods of installed packages, by name."""
    return announced("method", METHOD_GROUP, OWN, re.compile(r"[\w-]+").fullmatch, 'mine = "package.module:Mine"')


class _Methods(Mapping[str, Any]):
    """The methods of this package, and those that other packages announce."""

    def __getitem__(self, name: str) -> Any:
        if name not in OWN:
            return imported("method", name, announced_methods()[name], SettingsError)
        check_extra("learners", "eval", "il")
        return resolve_installed(f"magical_mj.learners.{OWN[name]}")

    def __contains__(self, name: object) -> bool:
        return name in OWN or name in announced_methods()

    def __iter__(self) -> Iterator[str]:
        return iter((*OWN, *announced_methods()))

    def __len__(self) -> int:
        return len(OWN) + len(announced_methods())


METHODS: Final = _Methods()
"""Name -> class, a subclass of `learner.Method`, of all methods that `train` supports by name."""

STATE: Final = "State"
"""The preset of the state track."""
LEARNABLE: Final = (*(name for name, kind in PRESETS.items() if kind.layout == "hwc" and kind.depth > 1), STATE)
"""The presets that learners support: one stack of pictures with the channels last, or states."""
AUGMENTATIONS: Final[Mapping[str, tuple[str, ...]]] = {
    "all": ("translation", "rotation", "colour", "noise"),
    "no-trans-rot": ("colour", "noise"),
    "none": (),
}
"""The sets of augmentations in the paper's ablations, by name."""
HEADS: Final = 4
"""The number of attention heads between blocks and regions. They share the units of `NetworkSettings.entity`."""

PICTURES: Final = Meta(extra={"observes": "pictures"})
"""Marks settings that have an effect only if observations are pictures."""
STATES: Final = Meta(extra={"observes": "states"})
"""Marks settings that have an effect only if observations are states."""
UnboundedCount = Annotated[int, Meta(ge=1)]
"""An integer of at least 1, like `Count`, but without an upper limit."""
Positive = Annotated[float, Meta(gt=0, le=1e9)]
NotNegative = Annotated[float, Meta(ge=0, le=1e9)]
Share = Annotated[float, Meta(ge=0, le=1)]


@dataclass(frozen=True)
class DemonstrationSettings(Settings, part="demos"):
    """The package's demonstrations, which all methods use."""

    set: Annotated[int, Meta(ge=1, le=2, description="1, which protocol 1 uses; 2: by more varied demonstrators")] = 1


@dataclass(frozen=True)
class NetworkSettings(Settings, part="network"):
    """The layers of all networks (appendix, "Network architecture"), at most `networks.MOST_PARAMETERS` weights."""

    first_kernel: Annotated[Count, PICTURES] = 5
    first_stride: Annotated[Count, PICTURES] = 1
    first_channels: Annotated[Count, PICTURES] = 64
    channels: Annotated[
        Count, PICTURES, Meta(description="of each of the other four 3 x 3 convolutions of stride 2")
    ] = 128
    frames: Annotated[int, PICTURES, Meta(ge=1, le=4, description="pictures: how many of the latest are used")] = 4
    hidden: Annotated[Count, Meta(description="units of each of the two linear layers")] = 256
    entity: Annotated[Count, STATES, Meta(description="states: units for the robot, each block and each region")] = 64
    attention: Annotated[
        int, STATES, Meta(ge=1, le=32, description="states: attention layers for blocks and regions")
    ] = 1

    def __post_init__(self) -> None:
        """Raises a `SettingsError` for invalid sizes."""
        super().__post_init__()
        if self.first_kernel % 2 == 0:
            raise SettingsError(f"network.first_kernel must be odd, not {self.first_kernel}")
        if self.entity % HEADS:
            raise SettingsError(f"network.entity must be a multiple of {HEADS}, not {self.entity}")


@dataclass(frozen=True)
class CloningSettings(Settings, part="bc"):
    """Behavioural cloning (appendix, table "Hyperparameters for BC experiments")."""

    batches: UnboundedCount = 20_000
    batch_size: Count = 32
    optimizer: Literal["sgd", "adam"] = "sgd"
    learning_rate: Annotated[Positive, Meta(description="at the start; it changes linearly from batch to batch")] = 1e-3
    final_learning_rate: Annotated[Positive, Meta(description="at the end")] = 1e-3
    momentum: Annotated[NotNegative, Meta(description="of SGD")] = 0.1
    heads: Annotated[Literal["normal", "uniform"], Meta(description="distribution of their initial weights")] = "normal"
    encoder: Annotated[
        str,
        PICTURES,
        Meta(description="pictures: the folder of a training, or a file; its convolutions are used, and not trained"),
    ] = ""

    def __post_init__(self) -> None:
        """Raises a `SettingsError` for invalid combinations."""
        super().__post_init__()
        if self.optimizer == "adam" and self.momentum != CloningSettings.momentum:
            raise SettingsError("bc.momentum has no effect with bc.optimizer=adam: it is for sgd")
        if self.final_learning_rate > self.learning_rate:
            raise SettingsError(
                f"learning rates must not rise: bc.final_learning_rate={self.final_learning_rate} must be at most "
                f"bc.learning_rate={self.learning_rate}; set both"
            )


@dataclass(frozen=True)
class InverseSettings(Settings, part="iq"):
    """IQ-Learn (Garg et al. 2021). The settings that it shares with behavioural cloning are in `bc`."""

    discount: Share = 0.99
    temperature: Annotated[Positive, Meta(description="of the policy; rewards are of a similar size")] = 0.01
    alpha: Annotated[Positive, Meta(description="smaller values enforce smaller rewards")] = 0.5


@dataclass(frozen=True)
class PointSettings(Settings, part="point"):
    """The position-invariant regulariser. The settings that it shares with behavioural cloning are in `bc`."""

    weight: Annotated[NotNegative, Meta(description="of the penalty in the loss")] = 1.0


@dataclass(frozen=True)
class PPOSettings(Settings, part="ppo"):
    """The policy's training in GAIL, WGAIL-GP, AIRL and AL (appendix, table "Hyperparameters for GAIL experiments")."""

    total_steps: Annotated[UnboundedCount, Meta(description="environment steps of the training")] = 1_000_000
    simulator: Annotated[
        Literal["mujoco", "warp"],
        Meta(description="The simulator of gail, wgail-gp, airl and al: MuJoCo, or MuJoCo Warp on DEVICE (extra gpu)."),
    ] = "mujoco"
    environments: Count = 32
    steps: Annotated[Count, Meta(description="in each environment, between two updates")] = 8
    epochs: Count = 12
    minibatch: Annotated[int, Meta(ge=2, description="samples")] = 64
    learning_rate: Annotated[Positive, Meta(description="of Adam at first; it falls linearly to 0")] = 6e-5
    discount: Share = 0.8
    gae_lambda: Share = 0.8
    entropy: NotNegative = 1e-5
    clip: Positive = 0.01
    anneal_clip: Annotated[
        bool, Meta(description="it falls to 0 with the learning rate; as in rlpyt, the paper's library")
    ] = True
    normalise_advantages: Annotated[bool, Meta(description="in each minibatch; rlpyt does not")] = False
    gradient_norm: Positive = 1.0
    averaging: Annotated[
        float, Meta(ge=0, lt=1, description="the decay of the policies' moving average, which is evaluated")
    ] = 0.0
    reward_deviation: Annotated[Positive, Meta(description="standard deviation of the normalised rewards")] = 0.1


@dataclass(frozen=True)
class DiscriminatorSettings(Settings, part="discriminator"):
    """The discriminator's training in GAIL, WGAIL-GP and AIRL (the table that `PPOSettings` names)."""

    steps: Annotated[Count, Meta(description="for each update of the policy")] = 12
    rollouts: Annotated[
        Count, Meta(description="number of the latest rollouts for the policy's samples; 4 in the released code")
    ] = 1
    batch_size: Annotated[
        int, Meta(ge=2, multiple_of=2, description="half the policy's, half the expert's samples")
    ] = 24
    learning_rate: Annotated[Positive, Meta(description="of Adam")] = 2.5e-5
    gradient_penalty: Annotated[NotNegative, Meta(description="of WGAIL-GP")] = 100.0


@dataclass(frozen=True)
class FeatureSettings(Settings, part="features"):
    """The feature function of AL (appendix, "Apprenticeship learning baseline")."""

    batches: Annotated[UnboundedCount, Meta(description="of the autoencoder's training")] = 8_192
    batch_size: Count = 24
    learning_rate: Annotated[Positive, Meta(description="of Adam; the paper does not say")] = 1e-4
    size: Count = 32
    samples: Annotated[Count, Meta(description="number of the policy's latest samples for the weight vector")] = 512


@dataclass(frozen=True)
class RewardSettings(Settings, part="reward"):
    """The learnt reward and the scenes of the method "ppo"."""

    run: Annotated[str, Meta(description="the folder of the training that learnt the reward")] = ""
    variant: Annotated[str, Meta(description="the variant of the scenes, such as Layout")] = "Demo"


@dataclass(frozen=True)
class TrainingSettings(Settings):
    """All settings of one training run.

    Raises:
        SettingsError, UnknownNameError: for invalid values.
    """

    method: Annotated[str, Meta(description="one of `magical_mj.learners.METHODS`, or the name of your own method")]
    tasks: Annotated[tuple[str, ...], Meta(description="several tasks mean multi-task learning")]
    seed: Annotated[
        int, Meta(ge=0, le=2**63 - 1, description="Determines which demonstrations are used, and all random numbers.")
    ] = 0
    demonstrations: Annotated[
        Count | None,
        Meta(description="number drawn for each task; by default 10 of the package's, and all of your own"),
    ] = None
    recordings: Annotated[
        str, Meta(description="the folder with your own demonstrations, instead of those that come with the tasks")
    ] = ""
    preset: Annotated[str, Meta(description="The observation preset, such as LoRes4A.")] = "LoRes4E"
    augment: Annotated[Literal["all", "none", "no-trans-rot"], Meta(description="all, none, or no-trans-rot.")] = "all"
    device: Annotated[str, Meta(description="auto, cpu, cuda, ...")] = "auto"
    renderer: Annotated[
        RendererName | None,
        PICTURES,
        Meta(description="The pictures' renderer: opengl or software; quick trainings use software."),
    ] = None
    evaluations: Annotated[
        Natural, Meta(description="number of evaluations on the demo variant during the training")
    ] = 10
    episodes: Annotated[Count, Meta(description="in each of these evaluations, for each task")] = 10
    checkpoints: Annotated[Count, Meta(description="number of checkpoints during the training")] = 50
    precision: Annotated[
        Literal["float32", "bfloat16"], Meta(description="of most computations of BC's network in training")
    ] = "float32"
    demos: DemonstrationSettings = field(default_factory=DemonstrationSettings)
    network: NetworkSettings = field(default_factory=NetworkSettings)
    bc: CloningSettings = field(default_factory=CloningSettings)
    iq: InverseSettings = field(default_factory=InverseSettings)
    point: PointSettings = field(default_factory=PointSettings)
    ppo: PPOSettings = field(default_factory=PPOSettings)
    discriminator: DiscriminatorSettings = field(default_factory=DiscriminatorSettings)
    features: FeatureSettings = field(default_factory=FeatureSettings)
    reward: RewardSettings = field(default_factory=RewardSettings)

    def __post_init__(self) -> None:
        """Checks each setting and their combinations."""
        super().__post_init__()
        for task in self.tasks:
            if task_spec(task).speeds:
                raise SettingsError(
                    f"learners choose among 18 actions, but the actions of {task} are speeds (docs/bodies.md)"
                )
        if not self.tasks or len(set(self.tasks)) < len(self.tasks):
            raise SettingsError(f"give one or several different tasks, not {list(self.tasks)}")
        if self.recordings and self.demos.set != DemonstrationSettings.set:
            raise SettingsError("demos.set is for the package's demonstrations: leave it out with your own")
        preset_named(self.preset)
        if self.preset not in LEARNABLE:
            raise SettingsError(
                f"learners support one stack of frames or states: preset must be one of {', '.join(LEARNABLE)}"
            )
        if self.method in METHODS:
            METHODS[self.method].check_values(self)

    @property
    def states(self) -> bool:
        """Whether observations are states instead of pictures."""
        return self.preset == STATE


ALL_PARTS: Final = tuple(item.name for item in fields(TrainingSettings) if is_dataclass(item.default_factory))
"""The settings with their own tables."""
