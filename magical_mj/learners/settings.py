"""The settings of a training, with the paper's hyperparameters as defaults; their presets, and their TOML files."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Literal

from msgspec import Meta

from magical_mj.envs.presets import PRESETS, preset_named
from magical_mj.rendering.backend import RendererName
from magical_mj.tasks.registry import TASKS, listed, task_name, task_spec
from magical_mj.utils.errors import SettingsError, check_name
from magical_mj.utils.files import read_toml
from magical_mj.utils.imports import check_named, resolve_installed, with_place
from magical_mj.utils.settings import Count, Names, Natural, Settings, changed

STATE: Final = "State"
"""The preset of the state track."""
LEARNABLE: Final = (*(name for name, kind in PRESETS.items() if kind.layout == "hwc" and kind.depth > 1), STATE)
"""The presets that learners can look at: one stack of pictures, the channels last, or states."""
AUGMENTATIONS: Final[Mapping[str, tuple[str, ...]]] = {
    "all": ("translation", "rotation", "colour", "noise"),
    "no-trans-rot": ("colour", "noise"),
    "none": (),
}
"""The sets of augmentations in the paper's ablations, by name."""
HEADS: Final = 4
"""Of the attention between blocks and regions, which share the units of `NetworkSettings.entity`."""
ASSUMPTIONS: Final = ("egocentric", "mirror", "rename", "displace", "detours")
"""What `relational` tries to assume about a task, in this order: see `magical_mj.learners.assumptions`."""
PREMISES: Final = {"mirror": "egocentric"}
"""Assumptions that are tried only where another one was kept."""
START: Final = "made"
"""The table of a config.toml that says when and with what a run was started; no setting."""
GROUP: Final = "magical_mj.methods"
"""The entry-point group in which installed packages announce methods, such as ``mine = "package.module:Mine"``."""

Amount = Annotated[int, Meta(ge=1)]
"""An integer of at least 1, however large."""
Positive = Annotated[float, Meta(gt=0, le=1e9)]
NotNegative = Annotated[float, Meta(ge=0, le=1e9)]
Share = Annotated[float, Meta(ge=0, le=1)]


@dataclass(frozen=True)
class NetworkSettings(Settings):
    """The layers that all networks share (appendix, "Network architecture"), of at most `networks.MOST_PARAMETERS`."""

    part: ClassVar[str] = "network"

    first_kernel: Count = 5
    first_stride: Count = 1
    first_channels: Count = 64
    channels: Annotated[Count, Meta(description="of each of the four 3 x 3 convolutions of stride 2 that follow")] = 128
    hidden: Annotated[Count, Meta(description="units of each of the two linear layers")] = 256
    entity: Annotated[Count, Meta(description="of states: units for the robot, each block and each region")] = 64
    attention: Annotated[int, Meta(ge=1, le=32, description="likewise: layers of attention between them")] = 1

    def __post_init__(self) -> None:
        """Raises a `SettingsError` for sizes that cannot be."""
        super().__post_init__()
        if self.first_kernel % 2 == 0:
            raise SettingsError(f"network.first_kernel must be odd, not {self.first_kernel}")
        if self.entity % HEADS:
            raise SettingsError(f"network.entity must be a multiple of {HEADS}, not {self.entity}")


@dataclass(frozen=True)
class CloningSettings(Settings):
    """Behavioural cloning (appendix, table "Hyperparameters for BC experiments")."""

    part: ClassVar[str] = "bc"

    batches: Amount = 20_000
    batch_size: Count = 32
    optimizer: Literal["sgd", "adam"] = "sgd"
    learning_rate: Annotated[Positive, Meta(description="at first; from batch to batch it moves linearly")] = 1e-3
    final_learning_rate: Annotated[Positive, Meta(description="at the end")] = 1e-3
    momentum: Annotated[NotNegative, Meta(description="of SGD")] = 0.1
    heads: Annotated[Literal["normal", "uniform"], Meta(description="how their first weights are drawn")] = "normal"

    def __post_init__(self) -> None:
        """Raises a `SettingsError` for combinations that cannot be."""
        super().__post_init__()
        if self.optimizer == "adam" and self.momentum != CloningSettings.momentum:
            raise SettingsError("bc.momentum is of bc.optimizer=sgd: with adam, it would have no effect")
        if self.final_learning_rate > self.learning_rate:
            raise SettingsError(
                f"learning rates fall: bc.final_learning_rate={self.final_learning_rate} must be at most "
                f"bc.learning_rate={self.learning_rate}; set both"
            )


@dataclass(frozen=True)
class InverseSettings(Settings):
    """IQ-Learn (Garg et al. 2021); what it shares with behavioural cloning is in `bc`."""

    part: ClassVar[str] = "iq"

    discount: Share = 0.99
    temperature: Annotated[Positive, Meta(description="of the policy; rewards are about as small")] = 0.01
    alpha: Annotated[Positive, Meta(description="the smaller, the smaller must rewards be")] = 0.5


@dataclass(frozen=True)
class PPOSettings(Settings):
    """The policy's side of GAIL, WGAIL-GP and AL (appendix, table "Hyperparameters for GAIL experiments")."""

    part: ClassVar[str] = "ppo"

    total_steps: Annotated[Amount, Meta(description="environment steps of the training")] = 1_000_000
    simulator: Annotated[
        Literal["mujoco", "warp"],
        Meta(description="What gail, wgail-gp and al play in: MuJoCo, or MuJoCo Warp on DEVICE (extra gpu)."),
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
        float,
        Meta(
            ge=0,
            lt=1,
            description="the share that each update leaves of the policies' moving average, which is evaluated",
        ),
    ] = 0.0
    reward_deviation: Annotated[Positive, Meta(description="to which rewards are normalised")] = 0.1


@dataclass(frozen=True)
class DiscriminatorSettings(Settings):
    """The discriminator's side of GAIL and WGAIL-GP (the same table)."""

    part: ClassVar[str] = "discriminator"

    steps: Annotated[Count, Meta(description="for each update of the policy")] = 12
    rollouts: Annotated[
        Count, Meta(description="the latest, of which the policy's samples are; 4 in the released code")
    ] = 1
    batch_size: Annotated[
        int, Meta(ge=2, multiple_of=2, description="half the policy's, half the expert's samples")
    ] = 24
    learning_rate: Annotated[Positive, Meta(description="of Adam")] = 2.5e-5
    gradient_penalty: Annotated[NotNegative, Meta(description="of WGAIL-GP")] = 100.0


@dataclass(frozen=True)
class FeatureSettings(Settings):
    """The feature function of AL (appendix, "Apprenticeship learning baseline")."""

    part: ClassVar[str] = "features"

    batches: Annotated[Amount, Meta(description="of the autoencoder's training")] = 8_192
    batch_size: Count = 24
    learning_rate: Annotated[Positive, Meta(description="of Adam; the paper does not say")] = 1e-4
    size: Count = 32
    samples: Annotated[Count, Meta(description="the policy's latest, for the weight vector")] = 512


@dataclass(frozen=True)
class RelationalSettings(Settings):
    """Behavioural cloning with assumptions that the demo scene must bear out; not in the paper."""

    part: ClassVar[str] = "relational"

    assumptions: Annotated[Names, Meta(description="those that are tried, in this order")] = ASSUMPTIONS
    hidden: Count = 64
    networks: Annotated[int, Meta(ge=1, le=100, description="whose probabilities are averaged")] = 1
    trial: Annotated[
        Count, Meta(description="updates, of 16 batches each, of each assumption's trial; twice that before the first")
    ] = 80
    batch_size: Count = 64
    learning_rate: Annotated[Positive, Meta(description="of Adam")] = 1e-3
    rollouts: Annotated[Count, Meta(description="episodes of the demo scene that judge a trial")] = 80
    loss: Annotated[
        Share,
        Meta(description="of score in the demo scene that an assumption may cost (1: all are kept)"),
    ] = 0.1
    detours: Annotated[Count, Meta(description="excursions that are tried")] = 1_000
    sharpness: Annotated[Positive, Meta(description="power of the probabilities that the policy draws from")] = 1.5

    def __post_init__(self) -> None:
        """Checks the names."""
        super().__post_init__()
        names = self.assumptions.split(",") if isinstance(self.assumptions, str) else self.assumptions
        names = tuple(name.strip() for name in names if name.strip())
        for name in names:
            check_name("assumption", name, ASSUMPTIONS)
        for number, name in enumerate(names):
            if name in PREMISES and PREMISES[name] not in names[:number]:
                raise SettingsError(f"{name} is tried where {PREMISES[name]} was kept: name {PREMISES[name]} before it")
        object.__setattr__(self, "assumptions", names)


@dataclass(frozen=True)
class TrainingSettings(Settings):
    """One training run, completely.

    Raises:
        SettingsError, UnknownNameError: for values that cannot be.
    """

    method: Annotated[str, Meta(description="one of `magical_mj.learners.METHODS`, or the name of one's own")]
    tasks: Annotated[tuple[str, ...], Meta(description="more than one is multi-task learning")]
    seed: Annotated[
        int,
        Meta(
            ge=0, le=2**63 - 1, description="Decides which demonstrations are learnt from, and all else that is drawn."
        ),
    ] = 0
    demonstrations: Annotated[Count, Meta(description="how many of each task's are drawn")] = 10
    preset: Annotated[str, Meta(description="What is looked at, such as LoRes4A.")] = "LoRes4E"
    augment: Annotated[
        Literal["all", "none", "no-trans-rot"],
        Meta(description="all, none, or no-trans-rot."),
    ] = "all"
    device: Annotated[str, Meta(description="auto, cpu, cuda, ...")] = "auto"
    renderer: Annotated[
        RendererName | None, Meta(description="What draws pictures: opengl or software; quick trainings use software.")
    ] = None
    evaluations: Annotated[
        Natural, Meta(description="how often the policy is evaluated on the demo variant during the training")
    ] = 10
    episodes: Annotated[Count, Meta(description="in each of these evaluations, for each task")] = 10
    checkpoints: Annotated[Count, Meta(description="how often everything is saved during the training")] = 50
    precision: Annotated[
        Literal["float32", "bfloat16"], Meta(description="of most of what BC's network computes in training")
    ] = "float32"
    network: NetworkSettings = field(default_factory=NetworkSettings)
    bc: CloningSettings = field(default_factory=CloningSettings)
    iq: InverseSettings = field(default_factory=InverseSettings)
    ppo: PPOSettings = field(default_factory=PPOSettings)
    discriminator: DiscriminatorSettings = field(default_factory=DiscriminatorSettings)
    features: FeatureSettings = field(default_factory=FeatureSettings)
    relational: RelationalSettings = field(default_factory=RelationalSettings)

    def __post_init__(self) -> None:
        """Checks each setting, and what must fit together."""
        super().__post_init__()
        for task in self.tasks:
            if task_spec(task).speeds:
                raise SettingsError(
                    f"learners choose among 18 actions, and those of {task} are speeds (docs/bodies.md)"
                )
        if not self.tasks or len(set(self.tasks)) < len(self.tasks):
            raise SettingsError(f"give one or several different tasks, not {list(self.tasks)}")
        preset_named(self.preset)
        if self.preset not in LEARNABLE:
            raise SettingsError(
                f"learners look at one stack of frames or at states: preset must be one of {', '.join(LEARNABLE)}"
            )
        if self.method == "bc" and self.ppo.simulator != "mujoco":
            raise SettingsError("bc learns without playing: a simulator is chosen for gail, wgail-gp and al")
        if "ppo" in PARTS.get(self.method, ()):
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
        if rollout % ppo.minibatch:
            raise SettingsError(
                f"minibatches must be of the same size: ppo.minibatch={ppo.minibatch} does not divide "
                f"ppo.environments x ppo.steps = {rollout}"
            )
        if ppo.total_steps < rollout:
            raise SettingsError(f"ppo.total_steps={ppo.total_steps} are too few for one rollout of {rollout} steps")
        if self.features.samples < tasks:
            raise SettingsError(
                f"features.samples={self.features.samples} must be at least one for each of {tasks} tasks"
            )


ALL_PARTS: Final = tuple(item.name for item in fields(TrainingSettings) if is_dataclass(item.default_factory))
"""The settings that are tables of their own."""
PARTS: Final[Mapping[str, tuple[str, ...]]] = {
    "bc": ("network", "bc"),
    "iq-learn": ("network", "bc", "iq"),
    "gail": ("network", "ppo", "discriminator"),
    "wgail-gp": ("network", "ppo", "discriminator"),
    "al": ("network", "ppo", "features"),
    "relational": ("relational",),
}
"""Method of this package -> the parts of the settings that it uses."""
_USERS: Final[Mapping[str, tuple[str, ...]]] = {
    "augment": ("bc", "gail", "wgail-gp", "iq-learn"),
    "precision": ("bc",),
    "discriminator.gradient_penalty": ("wgail-gp",),
}
"""Setting -> the methods that use it, where these are not all that use its part."""
_OF_PICTURES: Final = (
    "renderer",
    *(f"network.{name}" for name in ("first_kernel", "first_stride", "first_channels", "channels")),
)
_OF_STATES: Final = ("network.entity", "network.attention")

_SHORT: Final[Mapping[str, Any]] = {
    "ppo.steps": 16,
    "ppo.epochs": 4,
    "ppo.learning_rate": 3e-4,
    "ppo.discount": 0.9,
    "ppo.entropy": 0.003,
    "ppo.clip": 0.2,
    "ppo.anneal_clip": False,
    "ppo.normalise_advantages": True,
    "discriminator.steps": 6,
    "discriminator.learning_rate": 1e-4,
    "features.batches": 1_000,
    "features.learning_rate": 1e-3,
}
"""Of trainings that are short enough for two cores, from pictures or states."""

QUICK: Final[Mapping[str, Any]] = {
    **_SHORT,
    "renderer": "software",
    "network.first_stride": 4,
    "network.first_channels": 32,
    "network.channels": 64,
    "evaluations": 5,
    "checkpoints": 10,
    "bc.batches": 1_000,
    "bc.optimizer": "adam",
    "bc.final_learning_rate": 1e-5,
    "ppo.total_steps": 80_000,
    "discriminator.batch_size": 32,
}
"""The changes made by `quick`: a smaller network and shorter training, for two cores without an accelerator."""

STATE_TRACK: Final[Mapping[str, Any]] = {
    **_SHORT,
    "evaluations": 2,
    "checkpoints": 10,
    "bc.batches": 6_000,
    "bc.batch_size": 64,
    "bc.optimizer": "adam",
    "bc.learning_rate": 2e-3,
    "bc.final_learning_rate": 1e-5,
    "bc.heads": "uniform",
    "ppo.total_steps": 1_000_000,
    "ppo.minibatch": 128,
    "ppo.entropy": 0.02,
    "ppo.clip": 0.05,
    "ppo.averaging": 0.995,
    "discriminator.batch_size": 128,
    "discriminator.rollouts": 4,
}
"""The changes for the preset State, which the paper does not have."""

SHORT_AL: Final[Mapping[str, Any]] = {
    "ppo.learning_rate": 6e-5,
    "ppo.entropy": 1e-5,
    "ppo.clip": 0.01,
    "features.samples": 4096,
}
"""The paper's PPO in short trainings of AL, whose rewards change more than others' from one update to the next."""


def load_settings(
    method: str, tasks: str | tuple[str, ...], *, quick: bool = False, **changes: Any
) -> TrainingSettings:
    """The settings of a method: the paper's, changed for short trainings (`quick`, preset State), then by `changes`.

    Args:
        method: one of `magical_mj.learners.METHODS`, or the name of a method of the user's own.
        tasks: the tasks, as a tuple or separated by commas; "all" is all eight.
        quick: use a smaller network and a shorter training on pictures.
        changes: by field; those of parts with dots, as in ``**{"ppo.clip": 0.02}``.

    Raises:
        UnknownNameError: for an unknown task or setting.
        SettingsError: if a value is invalid, or `quick` is asked for with the preset State.
    """
    tasks = tuple(task_name(task) for task in listed(tasks, TASKS))
    settings, short = TrainingSettings(method, tasks), QUICK if quick else {}
    if isinstance(chosen := changes.get("preset"), str) and chosen == STATE:
        if quick:
            raise SettingsError("quick is for pictures: learning from states is quick as it is")
        short = STATE_TRACK
    if short and method == "al":
        short = {**short, **SHORT_AL}
    return changed(settings, {**short, **changes})


def announced_methods() -> Mapping[str, EntryPoint]:
    """The entry points of methods of installed packages, by name."""
    return {point.name: point for point in entry_points(group=GROUP) if point.name not in PARTS}


def load_method(name: str) -> Any:
    """The class of an announced method.

    Raises:
        SettingsError: if its module fails when it is imported, or has no such class.
    """
    point = announced_methods()[name]
    try:
        return resolve_installed("".join(point.value.split()))
    except Exception as error:
        raise SettingsError(f"the method {name!r} ({point.value}) cannot be imported: {with_place(error)}") from error


def parts_of(method: str) -> tuple[str, ...]:
    """The parts of the settings that a method uses; one that no package announces may use all of them."""
    return PARTS.get(method) or (load_method(method).parts if method in announced_methods() else ALL_PARTS)


def users(name: str) -> tuple[str, ...]:
    """The methods of this package that use a setting."""
    return tuple(method for method in PARTS if uses(method, name))


def uses(method: str, name: str) -> bool:
    """Whether a method may use a setting."""
    part, dot, _ = name.partition(".")
    in_use = method not in PARTS or method in _USERS.get(name, (method,))
    return in_use and (not dot or part in parts_of(method))


def check_changes(
    changes: Mapping[str, Any], methods: Collection[str], preset: Any = None, *, elsewhere: Collection[str]
) -> None:
    """Checks that changes have an effect.

    Args:
        changes: of settings.
        methods: for which they are.
        preset: what is looked at; None: as the changes say, or the default.
        elsewhere: the settings that are given in another place.

    Raises:
        SettingsError: if a change is given elsewhere, or none of the methods uses it, or not with this preset.
    """
    preset = preset or changes.get("preset", TrainingSettings.preset)
    for name in changes:
        if name in elsewhere:
            raise SettingsError(f"{name} is given by itself, and not among the settings that are changed")
        if name in (_OF_PICTURES if preset == STATE else _OF_STATES):
            kind = "pictures" if preset == STATE else "states"
            raise SettingsError(f"{name} is for {kind}, and of no use with the preset {preset}")
        if users(name) and not any(uses(method, name) for method in methods):
            raise SettingsError(f"{name} is for {', '.join(users(name))}, and of no use to {' or '.join(methods)}")


def to_toml(settings: TrainingSettings) -> str:
    """The settings that the method uses, as TOML; `from_toml` reads them."""
    plain, tables, parts = [], [], parts_of(settings.method)
    for item in fields(settings):
        value = getattr(settings, item.name)
        if is_dataclass(value) and item.name in parts:
            lines = [f"{inner.name} = {toml_value(getattr(value, inner.name))}" for inner in fields(value)]
            tables.append("\n".join([f"[{item.name}]", *lines]))
        elif not is_dataclass(value) and value is not None:
            plain.append(f"{item.name} = {toml_value(value)}")
    return "\n\n".join(["\n".join(plain), *tables]) + "\n"


def recorded(settings: TrainingSettings) -> dict[str, Any]:
    """Name -> value for everything that `to_toml` writes; names of nested parts contain dots."""
    return flattened(tomllib.loads(to_toml(settings)))


def from_toml(path: Path) -> TrainingSettings:
    """The settings in a file.

    Raises:
        SettingsError, UnknownNameError: if it is not TOML, or holds invalid settings.
        UntrustedNameError: if it names the code of a task that the user has not named.
    """
    table = read_toml(path)
    if not isinstance(table.pop(START, {}), dict):
        raise SettingsError(f"{START} in {path} must be a table, as a training writes it; remove it")
    if "method" not in table or "tasks" not in table:
        raise SettingsError(f"{path} must give a method and tasks")
    method, tasks = table.pop("method"), tuple(listed(table.pop("tasks"), TASKS))
    for task in tasks:
        check_named(task, path)
    return changed(TrainingSettings(method, tasks), flattened(table))


def flattened(table: dict[str, Any]) -> dict[str, Any]:
    """Name -> value; names in sub-tables contain dots."""
    flat = {}
    for name, value in table.items():
        flat |= {f"{name}.{inner}": item for inner, item in value.items()} if isinstance(value, dict) else {name: value}
    return flat


def toml_value(value: Any) -> str:
    """A value as TOML. What cannot be encoded, such as bytes of a file's name that are no UTF-8, is escaped twice."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(toml_value, value))}]"
    if isinstance(value, str):
        text = value.encode(errors="backslashreplace").decode()
        return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
    return json.dumps(value) if isinstance(value, bool) else repr(value)
