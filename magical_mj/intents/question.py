"""Questions about what demonstrations were for, with answers that can be checked exactly.

A question shows demonstrations of an intent, and a new scene. There are four tasks:

- ``choose``: which of four final scenes satisfies the intent? The wrong ones are the ends of other readings. In
  questions of the kind ``logic``, each of these readings is refuted by at least one demonstration and allowed by most,
  or is a shortcut; exact inference over the language finds the answer. In questions of the kind ``prior``, all
  demonstrations allow the other readings, so the answer shows which reading seems natural.
- ``say``: what is the intent? The answer is a text of the language. It is compared with the intent in `SCENES` scenes.
- ``place``: which final poses of the blocks satisfy the intent?
- ``act``: the same, reached in the simulation. The scene is that of the variant All and the seed.

Questions depend on the protocol number `INTENTS`, the set, the settings and the seed alone.
"""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain, islice
from typing import Any, Final

import numpy as np

from magical_mj.intents.ambiguity import Ends, Judge, rivals
from magical_mj.intents.choices import (
    CANDIDATES,
    READING_BITS,
    Option,
    allowed_readings,
    distinct,
    doubtful_readings,
    end_of,
    reading_ends,
    selection,
    shortcut_ends,
    weights,
)
from magical_mj.intents.contrast import simplest_rivals
from magical_mj.intents.intent import Intent, parse
from magical_mj.intents.names import NAMES, SETS
from magical_mj.intents.readings import moved_blocks, others_moved
from magical_mj.intents.scenes import ALL_RULES, redrawn
from magical_mj.intents.tasks import PREFIX, Task, spec_of
from magical_mj.protocol import INTENTS
from magical_mj.scene import Scene
from magical_mj.scene.geometry import check_scene
from magical_mj.tasks.planning import Noise
from magical_mj.tasks.registry import sample_scene
from magical_mj.utils.errors import IntentError, InvalidSceneError, SettingsError, as_integer, check_name, short_repr

TASKS: Final = ("choose", "say", "place", "act")
GIVEN: Final = ("demonstrations", "sentence", "both", "nothing", "wrong")
"""What a question shows: demonstrations, the sentence, both, nothing, or another intent's demonstrations."""
LETTERS: Final = "ABCD"
SCENE_COUNTS: Final = (1, 2, 4, 8)
SCENES: Final = 50
"""The number of scenes that compare an answer of ``say`` with the intent. Half refute simple rivals."""
TRIES: Final = 10
"""The number of new scenes that are drawn until one gives a question."""
REFUTING_DRAWS: Final = 20
"""The number of scenes that are drawn until one refutes a rival."""


@dataclass(frozen=True)
class Verdict:
    """The result of a check.

    Attributes:
        score: in [0, 1]; the share of scenes that agree for ``say``, otherwise 0 or 1.
        right: whether the answer is right: in all scenes, for ``say``.
        clean: whether it is right, and no block that had to stay has moved. For ``choose`` and ``say`` as `right`.
        misread: the reading or shortcut that a wrong answer follows; empty if none is known.
        problem: why the answer could not be right, such as overlapping blocks; otherwise empty.
    """

    score: float
    right: bool
    clean: bool
    misread: str = ""
    problem: str = ""


@dataclass(frozen=True)
class Question:
    """A question; make one with `questions`.

    Attributes:
        task: one of `TASKS`.
        id: its name, such as "choose/dev/3/logic".
        set: the set of its intent.
        kind: "logic" or "prior" for ``choose``; otherwise empty.
        intent: the intent that is asked for.
        name: the name of its task, with the settings of the demo scenes.
        demonstrations: for each demonstration, its scenes from the first to the last.
        sentence: the intent in English, if the question gives it; otherwise empty.
        scene: the new scene.
        options: the final scenes of ``choose``, A to D; otherwise empty.
        readings: the reading of each option, and "intended" for the right one.
        answer: a right answer: a letter, a text of the language, or a final scene as JSON.
        own: the intent's own demonstrations, also where others or none are given.
    """

    task: str
    id: str
    set: str
    kind: str
    name: str
    intent: Intent
    demonstrations: tuple[tuple[Scene, ...], ...]
    sentence: str
    scene: Scene
    options: tuple[Scene, ...] = ()
    readings: tuple[str, ...] = ()
    answer: str = ""
    own: tuple[tuple[Scene, ...], ...] = ()

    @property
    def watched(self) -> tuple[Ends, ...]:
        """The first and the last scene of each of the intent's own demonstrations."""
        return _ends(self.own)

    def check(self, answer: str | Scene) -> Verdict:
        """Whether an answer is right.

        Args:
            answer: a letter for ``choose``, a text of the language for ``say``, and a final scene, or its JSON, for
                ``place`` and ``act``.

        Raises:
            SettingsError: if the answer is of another form, such as the letter E, or a scene with other blocks.
        """
        if self.task == "choose":
            if not isinstance(answer, str) or answer not in LETTERS or len(answer) != 1:
                raise SettingsError(f"the answer is one of the letters {', '.join(LETTERS)}, not {answer!r}")
            right = answer == self.answer
            return Verdict(float(right), right, right, "" if right else self.readings[LETTERS.index(answer)])
        if self.task == "say":
            return self._check_said(str(answer))
        return self._check_final(answer if isinstance(answer, Scene) else Scene.from_json(answer))

    def _check_said(self, text: str) -> Verdict:
        try:
            said = parse(text)
        except IntentError as error:
            return Verdict(0.0, False, False, problem=str(error))
        trials = _trials(self.intent, self.watched[0][0])
        score = sum(_agree(said, self.intent, *trial) for trial in trials) / len(trials)
        return Verdict(score, score == 1.0, score == 1.0, "" if score == 1.0 else str(said))

    def _check_final(self, final: Scene) -> Verdict:
        try:
            changed = self.scene.moved(final.robot.pose, [block.pose for block in final.blocks])
        except InvalidSceneError as error:
            raise SettingsError(f"the final scene is not one of this question: {error}") from None
        if self.task == "place":
            try:
                check_scene(changed)
            except InvalidSceneError as error:
                return Verdict(0.0, False, False, problem=str(error))
        if changed == self.scene:
            return Verdict(0.0, False, False, problem="nothing has moved")
        right = self.intent.holds(self.scene, changed)
        clean = right and not others_moved(self.intent, self.scene, changed)
        return Verdict(float(right), right, clean, "" if right else self._misread(changed))

    def _misread(self, final: Scene) -> str:
        """The simplest reading of the first demonstration, or the first shortcut, that a wrong final scene follows."""
        pool = rivals(self.watched[:1], READING_BITS)
        reached = Judge(pool).reached(self.scene, final)
        found = next((str(one) for one, flag in zip(pool, reached, strict=True) if flag), "")
        moved = moved_blocks(self.scene, final)
        named = shortcut_ends(self.intent, self.watched, self.scene)
        return found or next((name for end, name in named if moved_blocks(self.scene, end) == moved), "")

    @property
    def data(self) -> dict[str, Any]:
        """The question with its answer, as JSON has it; `question_of` reads it."""
        return {
            "task": self.task,
            "id": self.id,
            "set": self.set,
            "kind": self.kind,
            "name": self.name,
            "intent": str(self.intent),
            "demonstrations": [list(map(_plain, shown)) for shown in self.demonstrations],
            "sentence": self.sentence,
            "scene": _plain(self.scene),
            "options": list(map(_plain, self.options)),
            "readings": list(self.readings),
            "answer": self.answer,
            "own": [list(map(_plain, shown)) for shown in self.own],
        }

    @property
    def digest(self) -> str:
        """The SHA-256 of `data` in hexadecimal digits. It is the same on every machine."""
        return hashlib.sha256(json.dumps(self.data, sort_keys=True).encode()).hexdigest()


def question_of(data: Mapping[str, Any]) -> Question:
    """The question with this `Question.data`."""

    def scenes(values: Iterable[Any]) -> tuple[Scene, ...]:
        return tuple(Scene.from_json(json.dumps(value)) for value in values)

    changed: dict[str, Any] = {
        "intent": parse(data["intent"]),
        "demonstrations": tuple(map(scenes, data["demonstrations"])),
        "scene": Scene.from_json(json.dumps(data["scene"])),
        "options": scenes(data["options"]),
        "readings": tuple(data["readings"]),
        "own": tuple(map(scenes, data["own"])),
    }
    return Question(**{**data, **changed})


def _plain(scene: Scene) -> Any:
    return json.loads(scene.to_json())


@dataclass(frozen=True)
class Settings:
    """The settings of questions; see `questions`."""

    seed: int
    scenes: int
    contrasting: bool
    demonstrations: int
    frames: int
    given: str


def questions(
    task: str,
    set: str = "dev",  # noqa: A002 - as everywhere: a set of intents
    *,
    seed: int = 0,
    scenes: int = 4,
    contrasting: bool = False,
    demonstrations: int | None = None,
    frames: int = 0,
    given: str = "demonstrations",
    limit: int | None = None,
) -> Iterator[Question]:
    """Questions about the intents of a set, in their order.

    For ``choose``, an intent gives two questions, of the kinds ``logic`` and ``prior``. With one demo scene there are
    only those of the kind ``prior``. Intents without a question are left out.

    Args:
        task: "choose", "say", "place" or "act".
        set: a set of `SETS`.
        seed: other seeds give other demo scenes, new scenes and options.
        scenes: the number of demo scenes: 1, 2, 4 or 8.
        contrasting: choose the demo scenes such that they refute as many simple rivals as possible.
        demonstrations: the number of demonstrations, in turn in the demo scenes; by default one in each.
        frames: the number of scenes of each demonstration between the first and the last one.
        given: "demonstrations", "sentence", "both", "nothing", or "wrong" for those of the set's next intent.
        limit: the greatest number of questions; by default all.

    Raises:
        SettingsError, UnknownNameError: if a setting is invalid.
    """
    check_name("task of questions", task, TASKS)
    check_name("set", set, tuple(NAMES))
    check_name("given", given, GIVEN)
    number = scenes if demonstrations is None else demonstrations
    least = {"seed": 0, "scenes": 1, "demonstrations": 1, "frames": 0, "limit": 0}
    values = (seed, scenes, number, frames, 0 if limit is None else limit)
    for (name, smallest), value in zip(least.items(), values, strict=True):
        if as_integer(value, smallest) is None:
            raise SettingsError(f"{name} must be an integer of at least {smallest}, not {short_repr(value)}")
    if scenes not in SCENE_COUNTS or not scenes <= number <= 8 * scenes:
        raise SettingsError(
            f"scenes is one of {SCENE_COUNTS}, and demonstrations is from scenes to 8 * scenes; not {scenes}, {number}"
        )
    if contrasting and scenes == 1:
        raise SettingsError("contrasting is for several demo scenes: give scenes=2, 4 or 8, or leave it out")
    settings = Settings(seed, scenes, contrasting, number, frames, given)
    return islice(_questions(task, set, settings), limit)


def expected(task: str, name: str, scenes: int, limit: int | None = None) -> int:
    """The number of questions, if there is one for each intent and kind."""
    number = len(SETS[name]) * len(_kinds(task, scenes))
    return number if limit is None else min(limit, number)


def _kinds(task: str, scenes: int) -> tuple[str, ...]:
    if task != "choose":
        return ("",)
    return ("prior",) if scenes == 1 else ("logic", "prior")


def _questions(task: str, name: str, settings: Settings) -> Iterator[Question]:
    kinds = _kinds(task, settings.scenes)
    for number in range(len(SETS[name])):
        for kind in kinds:
            question = _question(task, name, number, kind, settings)
            if question is not None:
                yield question


def _question(task: str, name: str, number: int, kind: str, settings: Settings) -> Question | None:
    intent = SETS[name][number]
    own = _demonstrated(intent, settings)
    ends = _ends(own)
    key = f"{INTENTS} {task} {name} {number} {kind} {settings.contrasting}"
    entropy = [zlib.crc32(key.encode()), settings.seed, settings.scenes, settings.demonstrations]
    rng = np.random.Generator(np.random.PCG64(entropy))
    label = f"{PREFIX}{_task_of(intent, settings)}"
    if task == "act":
        scene = sample_scene(label, "All", settings.seed)
        found = scene, end_of(intent, scene) or scene, []
    else:
        found = _chosen(intent, ends, kind, rng) if kind else _new_scene(intent, ends, rng)
    if found is None:
        return None
    scene, right, wrong = found
    options = [Option(right, "intended"), *wrong]
    order = rng.permutation(len(options)).tolist()
    shown = {
        "nothing": (),
        "sentence": (),
        "wrong": _demonstrated(SETS[name][(number + 1) % len(SETS[name])], settings),
    }.get(settings.given, own)
    answers = {"choose": LETTERS[order.index(0)], "say": str(intent)}
    return Question(
        task=task,
        id="/".join(filter(None, (task, name, str(number), kind))),
        set=name,
        kind=kind,
        name=label,
        intent=intent,
        demonstrations=shown,
        sentence=intent.sentence if settings.given in ("sentence", "both") else "",
        scene=scene,
        options=tuple(options[place].end for place in order) if kind else (),
        readings=tuple(options[place].reading for place in order) if kind else (),
        answer=answers.get(task) or right.to_json(),
        own=own,
    )


def _task_of(intent: Intent, settings: Settings) -> Task:
    return Task(intent, settings.seed, settings.scenes, settings.contrasting)


def _ends(demonstrations: Sequence[Sequence[Scene]]) -> tuple[Ends, ...]:
    return tuple((shown[0], shown[-1]) for shown in demonstrations)


@lru_cache(maxsize=64)  # the two questions of an intent, and the next intent's, if demonstrations are wrong
def _demonstrated(intent: Intent, settings: Settings) -> tuple[tuple[Scene, ...], ...]:
    """The demonstrations of an intent. Without scenes in between, each is the end of a plan."""
    spec = spec_of(_task_of(intent, settings))
    starts = [spec.demo, *spec.further_demos]
    if settings.frames:
        from magical_mj.intents.expert_data import frames_of  # which needs the simulator

        pairs = enumerate(starts[number % len(starts)] for number in range(settings.demonstrations))
        return tuple(frames_of(intent, start, number, settings.frames) for number, start in pairs)
    noise = Noise(np.random.Generator(np.random.PCG64([zlib.crc32(str(intent).encode()), settings.seed])), 1.0)
    shown = [(start, end_of(intent, start) or start) for start in starts]  # every demo scene has a plan
    for number in range(len(starts), settings.demonstrations):
        start, end = shown[number % len(starts)]
        shown.append((start, end_of(intent, start, noise) or end))
    return tuple(shown)


def _new_scene(
    intent: Intent, ends: Sequence[Ends], rng: np.random.Generator
) -> tuple[Scene, Scene, list[Option]] | None:
    """A scene that no demonstration has shown, with an end that satisfies the intent."""
    starts = {start for start, _ in ends}
    for _ in range(TRIES):
        scene = redrawn(intent, rng, ends[0][0], *ALL_RULES)
        right = end_of(intent, scene)
        if scene not in starts and right is not None:
            return scene, right, []
    return None


def _chosen(
    intent: Intent, ends: tuple[Ends, ...], kind: str, rng: np.random.Generator
) -> tuple[Scene, Scene, list[Option]] | None:
    """A new scene, the right end, and the wrong options."""
    allowed = allowed_readings(ends)
    doubtful = doubtful_readings(intent, ends, rng) if kind == "logic" else []
    for _ in range(TRIES):
        new = _new_scene(intent, ends, rng)
        if new is None:
            return None
        scene, right, _ = new
        if kind == "logic":
            options = chain(shortcut_ends(intent, ends, scene), reading_ends(doubtful, scene))
        else:
            options = reading_ends((allowed[place] for place in rng.permutation(len(allowed)).tolist()), scene)
        wrong = list(islice(distinct(intent, options, scene, right), CANDIDATES))
        if kind == "logic":
            wrong = _less_probable(allowed, scene, right, wrong)
        selected = selection(ends, scene, right, wrong, rng)
        if selected is not None:
            return scene, right, selected
    return None


def _less_probable(allowed: Sequence[Intent], scene: Scene, right: Scene, wrong: Sequence[Option]) -> list[Option]:
    """The wrong options that fulfil fewer of the allowed readings than the right end, weighted by their prior."""
    judge, prior = Judge(allowed), weights(allowed)
    most = float(prior @ judge.reached(scene, right))
    return [option for option in wrong if float(prior @ judge.reached(scene, option.end)) < most]


@lru_cache(maxsize=256)
def _trials(intent: Intent, demo: Scene) -> tuple[tuple[Scene, Scene, Scene | None], ...]:
    """Scenes with an end that satisfies the intent, and for the second half, the end of a rival that refutes it."""
    rng = np.random.Generator(np.random.PCG64([zlib.crc32(str(intent).encode()), INTENTS]))
    simplest = simplest_rivals(intent, demo)
    trials = list[tuple[Scene, Scene, Scene | None]]()
    while len(trials) < SCENES:
        scene = redrawn(intent, rng, demo, *ALL_RULES)
        wrong = None
        if simplest and len(trials) >= SCENES // 2:
            rival = simplest[len(trials) % len(simplest)]
            for _ in range(REFUTING_DRAWS):
                end = end_of(rival, scene)
                if end is not None and not intent.holds(scene, end):
                    wrong = end
                    break
                scene = redrawn(intent, rng, demo, *ALL_RULES)
        right = end_of(intent, scene)
        if right is not None:
            trials.append((scene, right, wrong))
    return tuple(trials)


def _agree(said: Intent, intent: Intent, scene: Scene, right: Scene, wrong: Scene | None) -> bool:
    """Whether an intent accepts the right end and not the wrong one, and its own plan satisfies the other intent."""
    if not said.grounded(scene) or not said.holds(scene, right):
        return False
    if wrong is not None and said.holds(scene, wrong):
        return False
    own = end_of(said, scene)
    return own is None or intent.holds(scene, own)
