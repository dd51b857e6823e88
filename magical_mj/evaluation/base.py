"""The settings of an evaluation, each with its type, default, bounds and description.

`BaseSettings` has those of the core. Additions derive from it: a subclass declares further settings, and overrides the
methods that they change. `magical_mj.evaluation.settings.EvaluationSettings` joins all subclasses that are installed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, Literal

import gymnasium
from gymnasium.vector import VectorEnv
from msgspec import Meta

from magical_mj._version import __version__
from magical_mj.envs.presets import DEFAULT_PRESET, preset_named
from magical_mj.evaluation.scores import MUJOCO_VERSION, EpisodeResult
from magical_mj.policies.interface import Episode
from magical_mj.protocol import DEMONSTRATIONS, PROTOCOL, SEEDS
from magical_mj.rendering.backend import RendererName, drawn_by
from magical_mj.scene.bodies import GRIPPER, check_body_name
from magical_mj.shifts import expand_shifts, shift_label
from magical_mj.shifts.registry import BODY, SHIFT_PROTOCOL, Effect, check_noticed, code_digests
from magical_mj.tasks import KNOWN
from magical_mj.tasks.languages import canonical_name, in_language
from magical_mj.tasks.registry import SPLITS, TASKS, Pair, code_digest, environments, task_spec
from magical_mj.tasks.spec import Rules
from magical_mj.utils.errors import SettingsError, check_name, short_repr
from magical_mj.utils.extras import check_extra
from magical_mj.utils.imports import is_reference, source_digest
from magical_mj.utils.parallel import Backend, check_backend
from magical_mj.utils.settings import LARGEST_SETTING, Count, Names, Natural, Settings

if TYPE_CHECKING:
    from magical_mj.demos.stored import Watch
    from magical_mj.policies.loading import Source

Split = Literal["test", "dev", "fresh"]
"""See `magical_mj.tasks.registry.SPLITS`."""
UNOFFICIAL: Final = (
    "official scores come from MuJoCo in double precision, where replays are exact; batched environments use single "
    "precision, so their scores are approximate"
)
SIDE_BY_SIDE: Final = 10
"""The most episodes that are played in one batch. They end together, so a killed evaluation loses the current batch."""


class Starts:
    """What policies receive at the start of episodes: the task's name, the variant and the scene.

    Subclasses can give more. They are sent to other processes before they are used.
    """

    @property
    def recorded(self) -> dict[str, str]:
        """Facts that a resumed evaluation must keep."""
        return {}

    def of(self, played: Episode, task: str, source: Source) -> tuple[Episode, dict[str, Any]]:  # noqa: ARG002
        """What the policy receives in an episode, and fields of its result. `task` is the name that it receives."""
        return replace(played, task=task), {}

    def finished(self, result: EpisodeResult) -> EpisodeResult:
        """The result with what can be computed only after the episode."""
        return result


@dataclass(frozen=True, kw_only=True)
class BaseSettings(Settings):
    """The settings of `evaluate` that the core declares.

    Raises:
        UnknownNameError: if a name is unknown.
        SettingsError: if a value is out of range, or settings are incompatible.
    """

    tasks: Annotated[Names, Meta(description="Tasks, separated by commas.")] = "all"
    variants: Annotated[
        Names, Meta(description="Variants, separated by commas; pairs that do not exist are left out.")
    ] = "all"
    episodes: Annotated[
        Count | None,
        Meta(description="Episodes in each environment, in successive scenes; by default 100, as in the paper."),
    ] = None
    split: Annotated[
        Split,
        Meta(
            description="test: the scenes of seeds 0, 1, ..., for results. dev: other scenes, to inspect and tune. "
            "fresh: scenes that nobody has played before, to confirm a score."
        ),
    ] = "test"
    first_seed: Annotated[Natural, Meta(description="The number of the first scene in its split.")] = 0
    preset: Annotated[
        str | None,
        Meta(
            description="The observations: a preset's name, or an empty one; by default the preset of the policies' "
            "training, or LoRes4E."
        ),
    ] = None
    rules: Annotated[Rules, Meta(description="Scores and horizons of the paper, or of its released code.")] = "paper"
    out: Annotated[Path | None, Meta(description="The folder for the scores.")] = None
    resume: Annotated[bool, Meta(description="Continue the evaluation in OUT.")] = False
    retry_failed: Annotated[
        bool, Meta(description="With resume: play failed episodes again; their rows count the retries.")
    ] = False
    jobs: Annotated[
        Count | None,
        Meta(
            description="Number of worker processes; by default one per core, if there is enough work. With 1, "
            "everything is played in this process; environments of a policy that acts in batches use all cores."
        ),
    ] = None
    backend: Annotated[Backend, Meta(description="Where the workers run: on this machine or on a cluster.")] = "local"
    address: Annotated[str | None, Meta(description="The cluster's address, such as tcp://host:8786.")] = None
    run: Annotated[Natural, Meta(description="The number of the (first) run of each method.")] = 0
    time_limit: Annotated[
        Annotated[float, Meta(ge=0.1, le=LARGEST_SETTING)],
        Meta(
            description="Seconds after which an episode counts as failed. If a call of the policy does not return, its "
            "worker process is killed; with jobs 1, it cannot be stopped."
        ),
    ] = 300.0
    renderer: Annotated[RendererName | None, Meta(description="The renderer of pictures: opengl or software.")] = None
    trust: Annotated[bool, Meta(description="Run the code that model files contain.")] = False
    shifts: Annotated[
        str, Meta(description="Shifts to play in addition to none: camera:1-5,light,body; or all. See docs/shifts.md.")
    ] = ""
    wrap: Annotated[
        str,
        Meta(
            description="A Gymnasium wrapper around the environment, package.module:NAME, which is made anew for each "
            "episode. Not for batches."
        ),
    ] = ""
    body: Annotated[str, Meta(description="The robot's body. See docs/bodies.md.")] = GRIPPER
    like: Annotated[str, Meta(description="The task name that policies receive instead of the real one.")] = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_body_name(self.body)
        self.shift_labels()
        preset_named(self.observed)
        check_backend(self.backend, self.address)
        if self.resume and self.out is None:
            raise SettingsError("resume continues the evaluation in a folder: give out as well")
        if self.retry_failed and not self.resume:
            raise SettingsError("retry_failed plays failed episodes of a folder again: give resume as well (--resume)")
        if self.like:
            canonical_name(self.like) if in_language(self.like) else check_name("task", self.like, TASKS)
        if self.wrap and not is_reference(self.wrap):
            raise SettingsError(f"wrap must be package.module:NAME of a Gymnasium wrapper, not {short_repr(self.wrap)}")

    @property
    def observed(self) -> str:
        """The preset of the observations. The default, if none was given and the policies are not loaded yet."""
        return DEFAULT_PRESET if self.preset is None else self.preset

    worlds: ClassVar[str] = "single"
    """The simulator's name in files: "single" for MuJoCo, "batched" for MuJoCo Warp."""
    side_by_side: ClassVar[int] = SIDE_BY_SIDE
    batched: ClassVar[bool] = False
    """Whether all episodes are played in batches."""

    def check_extras(self) -> None:
        """Raises a `MissingExtraError` unless everything that the settings need is installed."""
        check_extra("evaluations", "eval")
        if self.backend != "local":
            check_extra(f"workers of {self.backend}", self.backend)

    def check_policies(self, policies: Sequence[Source]) -> None:
        """Raises a `SettingsError` unless the settings fit the policies."""
        if receive := [policy.name for policy in policies if "demonstrations" in policy.uses]:
            raise SettingsError(
                f"{receive[0]} receives demonstrations, and none can be given: magical_mj.intents is missing"
            )

    def descriptions(self, policy: Source) -> list[str]:
        """The descriptions of a task that a policy receives, such as "8 demonstrations in 4 scenes"."""
        return [] if "instruction" in policy.unnoticed else ["instruction"]

    def given(self, policy: Source) -> str:
        """The descriptions as one text. Empty if the policy receives none."""
        return " and ".join(self.descriptions(policy))

    def starts(self, policies: Sequence[Source], watch: Watch) -> Starts:  # noqa: ARG002
        """What the policies receive at the start of episodes. `watch` is called while it is made."""
        return Starts()

    def vector_env(
        self, task: str, variant: str, number: int, shifts: str, instruction: bool
    ) -> VectorEnv[Any, Any, Any]:
        """The vector environment for that number of episodes. `instruction` is whether policies read the sentence."""
        from magical_mj.envs.vector import make_vec  # imported late: it loads the simulator

        threads = None if self.jobs == 1 else 1  # other worker processes use the other cores
        return make_vec(
            task,
            number,
            variant=variant,
            preset=self.observed,
            autoreset_mode=gymnasium.vector.AutoresetMode.DISABLED,
            threads=threads,
            instruction=instruction,
            rules=self.rules,
            renderer=self.renderer,
            shifts=shifts,
            body=self.body,
        )

    @cached_property
    def environments(self) -> list[Pair]:
        """The pairs of task and variant that are played."""
        return environments(self.tasks, self.variants)

    def shift_labels(self, policies: Sequence[Source] = ()) -> dict[str, list[str]]:
        """For each task, the labels of the shifts that are played, as in results. The first is "", without a shift.

        "all" leaves out shifts that one of the policies does not notice: its score would show a robustness that it
        does not have.

        Raises:
            SettingsError: if an axis is named that one of the policies does not notice, or if the expert plays and
                cannot solve the task with the body.
        """
        labels, unnoticed = dict[str, list[str]](), set[Effect]()
        for policy in policies:
            unnoticed |= policy.unnoticed
        for task in dict.fromkeys(task for task, _ in self.environments):
            settings = expand_shifts(self.shifts, task, unnoticed)
            bodies = [self.body, *(str(setting[BODY]) for setting in settings if BODY in setting)]
            for policy in policies:
                for setting in settings:
                    check_noticed(setting, policy.name, policy.unnoticed)
                for body in bodies if policy.needs_plan else ():
                    task_spec(task).check_expert_body(body)
            known = dict.fromkeys(["", *map(shift_label, settings)])
            known.pop(f"{BODY}:{self.body}", None)  # all episodes have it
            labels[task] = list(known)
        return labels

    @cached_property
    def seeds(self) -> range:
        """The seeds of the scenes."""
        first = SPLITS[self.split] + self.first_seed
        return range(first, first + (self.episodes or SEEDS))

    def recorded(self, policies: Sequence[Source] = ()) -> dict[str, Any]:
        """The settings that determine scores, and the policies if given. A resumed evaluation must keep them."""
        played = []
        for policy in policies:
            given = self.given(policy)
            played.append({**policy.described(), **({"given": given} if given else {})})
        labels, own = self.shift_labels(policies), dict[str, str]()
        shifts = dict.fromkeys(chain.from_iterable(labels.values()))
        for task in labels:
            own |= {} if task in KNOWN else {task: code_digest(task)}
        for label in (*shifts, f"{BODY}:{self.body}"):
            own |= code_digests(label)
        own |= {self.wrap: source_digest(self.wrap)} if self.wrap else {}
        return {
            **({"policies": played} if policies else {}),
            "environments": list(map("-".join, self.environments)),
            "split": self.split,
            "first_seed": self.first_seed,
            "episodes": len(self.seeds),
            "preset": self.observed,
            "rules": self.rules,
            "time_limit": self.time_limit,
            "worlds": self.worlds,
            "protocol": PROTOCOL,
            "shift_protocol": SHIFT_PROTOCOL,
            "demonstrations": DEMONSTRATIONS,
            "version": __version__,
            "mujoco": MUJOCO_VERSION,
            "gl": drawn_by(self.renderer),
            "shifts": list(shifts),
            "wrap": self.wrap,
            "like": self.like,
            "body": self.body,
            **{f"code of {name}": digest for name, digest in own.items()},
        }
