"""The demonstrations that policies receive at test time, and controls: episodes with those of another task.

Controls show whether a policy uses the demonstrations or the instruction. If it has the same score with the
demonstrations of another task, it ignores them. With the instruction of another task in the same scenes, it should
pursue that task. The settings of `evaluate` for both are declared here.
"""

from __future__ import annotations

import hashlib
import itertools
import re
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from msgspec import Meta

from magical_mj.evaluation.base import BaseSettings, Starts
from magical_mj.evaluation.replay import engine_for, replay_problem
from magical_mj.evaluation.scores import EpisodeResult
from magical_mj.intents import EIGHT, SETS, Intent
from magical_mj.intents.expert_data import with_scenes
from magical_mj.intents.names import (
    OFFICIAL_EPISODES,
    OFFICIAL_VARIANTS,
    TESTS,
    has_intent,
    task_intent,
    tasks_in,
)
from magical_mj.intents.tasks import PREFIX, task_of
from magical_mj.policies.interface import Episode, Transitions
from magical_mj.policies.loading import Source
from magical_mj.protocol import SEEDS
from magical_mj.rendering.backend import RendererName
from magical_mj.scene import Scene
from magical_mj.tasks.registry import TASKS, Names, listed, sample_scene, task_spec
from magical_mj.utils.errors import DemonstrationError, SettingsError, counted
from magical_mj.utils.settings import Count, fitting

if TYPE_CHECKING:
    from magical_mj.demos import Demonstration
    from magical_mj.demos.stored import Stored, Watch


Control = Literal["wrong-demonstrations", "wrong-instruction"]
DEMONSTRATIONS_GIVEN: Final = 8


OFFICIAL: Final = "intents"
"""Among `tasks`, this means the test sets; alone, by default two episodes in each of Layout and All."""
_DEMONSTRATIONS: Final = re.compile(r"([1-9][0-9]{0,2}) demonstrations?(?: in ([1-8]) (contrasting )?scenes?)?")


@dataclass(frozen=True, kw_only=True)
class GivenSettings(BaseSettings):
    """Settings for the demonstrations and instructions that policies receive, and the tasks `intents`."""

    panel = "Demonstrations and controls"

    demonstrations: Annotated[
        Count | None,
        Meta(
            description="How many demonstrations policies with uses_demonstrations = True receive; "
            f"by default {DEMONSTRATIONS_GIVEN}."
        ),
    ] = None
    scenes: Annotated[
        Count | None,
        Meta(description="Number of demo scenes of these demonstrations, 1 to 8; by default that of the task."),
    ] = None
    contrasting: Annotated[
        bool, Meta(description="Choose demo scenes that refute many rivals of the intent, instead of random scenes.")
    ] = False
    control: Annotated[
        Control | None,
        Meta(
            description="A control, wrong-demonstrations or wrong-instruction: policies receive those of another task."
        ),
    ] = None

    def __post_init__(self) -> None:
        tasks = fitting("tasks", self.tasks, Names)
        if OFFICIAL in (names := listed(tasks, TASKS)):
            is_alone = {*names} == {OFFICIAL}
            if not is_alone and (self.variants == "all" or self.episodes is None):
                raise SettingsError(
                    f"{OFFICIAL} are played in {' and '.join(OFFICIAL_VARIANTS)}, {OFFICIAL_EPISODES} episodes each, "
                    f"and other tasks in all variants, {SEEDS} episodes each: evaluate them apart, or give variants "
                    f"and episodes of both (--variants {','.join(OFFICIAL_VARIANTS)} --episodes {OFFICIAL_EPISODES})"
                )
            sets = [f"{PREFIX}{name}" for name in TESTS]
            tasks = tuple(one for name in names for one in (sets if name == OFFICIAL else [name]))
            if self.variants == "all":
                object.__setattr__(self, "variants", ",".join(OFFICIAL_VARIANTS))
            if self.episodes is None:
                object.__setattr__(self, "episodes", OFFICIAL_EPISODES)
        object.__setattr__(self, "tasks", tasks)
        super().__post_init__()
        if (self.scenes or 1) > self.number_given:
            raise SettingsError(
                f"{counted(self.number_given, 'demonstration')} cannot be spread over {self.scenes} scenes: give more "
                "demonstrations, or fewer scenes"
            )
        if self.control and (self.shifts or self.wrap or self.batched):
            raise SettingsError(
                f"the control {self.control} is played in MuJoCo, without shifts and wrappers: leave those out"
            )

    @property
    def number_given(self) -> int:
        """The number of demonstrations that policies receive."""
        return DEMONSTRATIONS_GIVEN if self.demonstrations is None else self.demonstrations

    def descriptions(self, policy: Source) -> list[str]:
        """The descriptions of a task that a policy receives, such as "8 demonstrations in 4 scenes"."""
        parts = super().descriptions(policy)
        if self.control == "wrong-instruction":
            parts = [f"another task's {part}" for part in parts]
        if "demonstrations" not in policy.uses:
            return parts
        kind = "contrasting scene" if self.contrasting else "scene"
        where = ""
        if self.scenes is not None:
            where = f" in {counted(self.scenes, kind)}"
        elif self.contrasting:
            where = f" in {kind}s"
        whose = "another task's " if self.control == "wrong-demonstrations" else ""
        return [f"{whose}{counted(self.number_given, 'demonstration')}{where}", *parts]

    def check_policies(self, policies: Sequence[Source]) -> None:
        """Raises a `SettingsError` if no policy receives the demonstrations, or one does not fit the control."""
        receive = any("demonstrations" in policy.uses for policy in policies)
        if not receive and (self.demonstrations or self.scenes or self.contrasting):
            raise SettingsError(
                "demonstrations, scenes and contrasting are for policies with uses_demonstrations = True, and none of "
                f"{', '.join(policy.name for policy in policies)} has it"
            )
        for policy in policies:
            if self.control and "another" not in self.given(policy):
                needed = "demonstrations" if self.control == "wrong-demonstrations" else "instruction"
                raise SettingsError(f"the control {self.control} is for policies with uses_{needed} = True")

    def starts(self, policies: Sequence[Source], watch: Watch) -> Starts:
        """The starts with demonstrations or instructions, if a policy receives any."""
        if not self.control and not any("demonstrations" in policy.uses for policy in policies):
            return super().starts(policies, watch)
        return GivenStarts(self, policies, watch)


def settings_of(given: str) -> dict[str, Any]:
    """The settings of a description that `GivenSettings.given` made, without a control."""
    found = _DEMONSTRATIONS.match(given)
    if found is None:
        return {}
    number, scenes, contrasting = found.groups()
    return {
        "demonstrations": int(number),
        "scenes": None if scenes is None else int(scenes),
        "contrasting": contrasting is not None,
    }


def demonstrations_given(
    settings: GivenSettings, watch: Watch = lambda _, __: None
) -> dict[str, tuple[Demonstration | Stored, ...]]:
    """Played task -> the demonstrations that policies receive.

    Demonstrations of intents are by the expert. If neither the package nor the user's cache contains them, they are
    made, with calls of `watch`.

    Raises:
        DemonstrationError: if a task has too few, or the expert fails.
        SettingsError: if it has too few demo scenes, or a control needs an intent and it has none.
        IntentError: if an intent has too few demo scenes.
    """
    from magical_mj.demos import stored  # imported late: it loads the simulator

    wrong, number = settings.control == "wrong-demonstrations", settings.number_given
    tasks = list(dict.fromkeys(task for task, _ in settings.environments))
    demonstrated = {task: other_tasks(task)[0] if wrong else task for task in tasks}
    intents = {
        task: with_scenes(name, settings.scenes, contrasting=settings.contrasting)
        for task, name in demonstrated.items()
        if name.startswith(PREFIX)
    }
    keys = [(intent, "Demo", seed) for intent in intents.values() for seed in range(number)]
    path, known = stored.default_path(), stored.shipped()
    complete = iter(stored.complete(keys, path, known=known, jobs=settings.jobs, watch=watch))
    return {
        task: tuple(itertools.islice(complete, number)) if task in intents else _shipped(name, settings)
        for task, name in demonstrated.items()
    }


def _shipped(task: str, settings: GivenSettings) -> tuple[Demonstration, ...]:
    from magical_mj import demos  # imported late: it loads the simulator

    if (settings.scenes or 1) > 1 or settings.contrasting:
        raise SettingsError(f"{task} has one demo scene: leave out scenes and contrasting, which are for intents")
    known = demos.load(task)
    if len(known) < settings.number_given:
        count = counted(len(known), "demonstration")
        raise DemonstrationError(f"{task} has {count}, so no policy can receive {settings.number_given}")
    return tuple(known[: settings.number_given])


def digest_of(demonstrations: Sequence[Demonstration | Stored]) -> str:
    """The SHA-256 hash of the scenes and the actions of demonstrations."""
    digest = hashlib.sha256()
    for demo in demonstrations:
        actions = demo.actions.encode() if isinstance(demo.actions, str) else demo.actions.tobytes()
        scene = demo.scene if isinstance(demo.scene, str) else demo.scene.digest()
        digest.update(f"{scene} {len(actions)} ".encode() + actions)
    return digest.hexdigest()


def with_states(demonstrations: Sequence[Demonstration | Stored]) -> tuple[Demonstration, ...]:
    """Demonstrations with their states. Stored actions are replayed; those of another version are an error."""
    from magical_mj.demos import Demonstration, stored  # imported late: it loads the simulator

    path = stored.default_path()
    return tuple(demo if isinstance(demo, Demonstration) else demo.verified(path) for demo in demonstrations)


def intent_of(task: str) -> Intent:
    """The intent of a task. Raises a `SettingsError` if there is none."""
    if not has_intent(task):
        raise SettingsError(
            f"controls are for intents and for tasks that have some, {', '.join(EIGHT)}, not for {task}"
        )
    return task_intent(task)


def other_tasks(task: str) -> list[str]:
    """The other tasks of the benchmark, beginning with the next one.

    For an intent, the other intents of its set, with as many demo scenes. If it is in no set, the intents of the
    benchmark's tasks.
    """
    if task in EIGHT:
        return _after(task, list(EIGHT))
    own = task_of(task.removeprefix(PREFIX))
    name = f"{PREFIX}{replace(own, demos=1, contrasting=False)}"
    sets = ([f"{PREFIX}{task}" for task in tasks_in(each)] for each in SETS)
    names = next((each for each in sets if name in each), [f"{PREFIX}{intent}" for intent in EIGHT.values()])
    return [with_scenes(other, own.demos, contrasting=own.contrasting) for other in _after(name, names)]


def _after(task: str, names: list[str]) -> list[str]:
    """The tasks with other intents, beginning with the one after this task."""
    after = names.index(task) + 1 if task in names else 0
    return [name for name in (*names[after:], *names[:after]) if intent_of(name) != intent_of(task)]


def other_task(task: str, variant: str, seed: int, body: str | None) -> str:
    """The task whose demonstrations or instruction replace those of this task in a control.

    With a body, it is the next task that can be pursued in the scene of this seed, or a `SettingsError` is raised.
    """
    others = other_tasks(task)
    if body is None:
        return others[0]
    scene = sample_scene(task, variant, seed, body)
    for other in others:
        if _can_be_pursued(intent_of(other), scene):
            return other
    raise SettingsError(
        f"no other task can be pursued in {task} {variant}, seed {seed}, so it cannot be played with this control"
    )


def _can_be_pursued(intent: Intent, scene: Scene) -> bool:
    """Whether an intent has a meaning in a scene, and does not hold in it."""
    return intent.grounded(scene) and not intent.holds(scene, scene)


def with_other_score(episode: EpisodeResult) -> EpisodeResult:
    """The episode. In a control, with the score of the other task's intent, computed by a replay."""
    if not episode.other or episode.failure is not None:
        return episode
    intent = intent_of(episode.other)
    with closing(engine_for(episode)) as engine:
        if not _can_be_pursued(intent, initial := engine.initial_scene) or replay_problem(episode, engine):
            return episode
        return replace(episode, other_score=intent.score(initial, engine.scene))


class GivenStarts(Starts):
    """Starts with demonstrations for the policies that use some, and in a control with those of another task."""

    def __init__(self, settings: GivenSettings, policies: Sequence[Source], watch: Watch) -> None:
        """Gets the demonstrations, if a policy uses some, with `watch` and the errors of `demonstrations_given`."""
        self.settings = settings
        receive = any("demonstrations" in policy.uses for policy in policies)
        self.demonstrations = demonstrations_given(settings, watch) if receive else {}
        self._last: tuple[tuple[str, str], tuple[Any, ...]] = ("", ""), ()

    @property
    def recorded(self) -> dict[str, str]:
        """The digests of the demonstrations."""
        return {f"demonstrations of {task}": digest_of(demos) for task, demos in self.demonstrations.items()}

    def of(self, played: Episode, task: str, source: Source) -> tuple[Episode, dict[str, Any]]:
        """The demonstrations in the form that the policy uses; in a control, also the other task and its sentence."""
        received, digest, other, sentence = (), "", "", ""
        if "demonstrations" in source.uses:
            received = self._received(played.task, source)
            digest = digest_of(self.demonstrations[played.task])[:16]
        if self.settings.control:
            misled = self.settings.control == "wrong-instruction"
            other = other_task(played.task, played.variant, played.seed, self.settings.body if misled else None)
            sentence = task_spec(other).instruction if misled else ""
        episode = replace(played, task=task, instruction=sentence, demonstrations=received)
        return episode, {"other": other, "demonstrations": digest}

    def _received(self, task: str, source: Source) -> tuple[Any, ...]:
        """The demonstrations of a task for a policy. The last ones are kept."""
        preset = "" if "simulation" in source.uses else self.settings.observed
        if self._last[0] != (task, preset):
            demos = with_states(self.demonstrations[task])
            received = demos if "simulation" in source.uses else observed(demos, preset, self.settings.renderer)
            self._last = (task, preset), received
        return self._last[1]

    def finished(self, result: EpisodeResult) -> EpisodeResult:
        """In a control, with the score of the other task's intent."""
        return with_other_score(result)


def observed(
    demonstrations: Sequence[Demonstration], preset: str, renderer: RendererName | None
) -> tuple[Transitions, ...]:
    """Demonstrations as observations and actions. The arrays are read-only, since all episodes share them."""
    from magical_mj.demos.learning import stream  # imported late: it loads the simulator

    parts = tuple(stream(demonstrations, preset, drop_noop=False, renderer=renderer))
    for part in parts:
        views = part.observations.values() if isinstance(part.observations, dict) else (part.observations,)
        for array in (*views, part.actions):
            array.setflags(write=False)
    return parts
