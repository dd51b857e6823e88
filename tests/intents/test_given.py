"""Demonstrations at test time, and controls in which demonstrations or instructions belong to another task."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import magical_mj
from magical_mj.demos import stored
from magical_mj.evaluation import Episode, EvaluationSettings
from magical_mj.evaluation.folder import SETTINGS
from magical_mj.evaluation.reports.results import results
from magical_mj.evaluation.reports.tables import control_tables, result_tables
from magical_mj.evaluation.scores import read
from magical_mj.intents import EIGHT
from magical_mj.intents.given import demonstrations_given, digest_of, other_tasks, with_states
from magical_mj.leaderboard import check_entries, read_entry, submit
from magical_mj.leaderboard.standings import standing
from magical_mj.policies.interface import NEUTRAL
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import DemonstrationError, EvaluationError, IntentError, SettingsError
from tests.helpers import agents
from tests.helpers.agents import Acting
from tests.helpers.commands import Shell
from tests.helpers.evaluations import SMALL, TEMPLATE, evaluate, write

DEMO: dict[str, Any] = {"variants": "Demo", "episodes": 1}
INTENT = "intent:wall(any, all, any)"


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache folder of the test's own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"


class Copying:
    """Checks that it gets what it would see if it repeated the first demonstration, and repeats it."""

    uses_demonstrations = True

    def __init__(self, preset: str) -> None:
        self.preset = preset

    def reset(self, episode: Episode) -> None:
        assert (episode.task, episode.instruction, episode.env) == (NEUTRAL, "", None)
        assert len(episode.demonstrations) == 2
        observations, actions = episode.demonstrations[0]
        parts = observations if isinstance(observations, dict) else {"": observations}
        assert all(len(part) == len(actions) and not part.flags.writeable for part in parts.values())
        self._parts, self._actions, self._step = parts, actions, -1

    def __call__(self, observation: Any) -> int:
        self._step += 1
        if self._step >= len(self._actions):
            return 0
        seen = observation if isinstance(observation, dict) else {"": observation}
        assert seen.keys() == self._parts.keys()
        for name, part in seen.items():
            np.testing.assert_array_equal(part, self._parts[name][self._step])
        return int(self._actions[self._step])


@pytest.mark.parametrize("preset", ["State", "LoRes4E", "LoResFingers"])
def test_demonstrations_have_the_observations_of_the_policy(preset: str) -> None:
    (row,) = evaluate(Copying(preset), preset=preset, demonstrations=2, **DEMO).to_dict("records")
    assert (row["failure"], row["score"], row["given"]) == (None, 1.0, "2 demonstrations")


def test_demonstrations_say_which_task_it_is_in_any_number_of_processes() -> None:
    tasks = {**SMALL, **DEMO, "tasks": "MoveToRegion,MoveToCorner", "episodes": 2}
    alone, spread, together = (
        evaluate(policy, **{**tasks, "jobs": jobs}, name="Nearest")
        for policy, jobs in ((agents.Nearest(), 1), (agents.Nearest(), 2), (agents.NearestOfAll(), 1))
    )
    assert (alone["score"] == 1.0).all()
    assert alone.equals(spread)
    assert alone.equals(together)
    assert alone["demonstrations"].nunique() == 2


def test_a_policy_with_the_simulation_gets_the_scenes() -> None:
    known: list[Any] = []
    policy = Acting(reset=known.append, uses_simulation=True, uses_demonstrations=True)
    evaluate(policy, **DEMO)
    shown = known[0].demonstrations
    assert [demo.digest for demo in shown] == [demo.digest for demo in magical_mj.demos.load("MoveToRegion")[:8]]


def test_resuming_with_other_demonstrations_is_refused(tmp_path: Path) -> None:
    how: dict[str, Any] = {**DEMO, "out": tmp_path, "demonstrations": 2}
    evaluate("tests.helpers.agents:Nearest", **how)
    how["resume"] = True
    known = json.loads((tmp_path / SETTINGS).read_text())
    digest = known["demonstrations of MoveToRegion"]
    assert digest[:16] == read(tmp_path)[0].demonstrations
    for other in ({"demonstrations": 3}, {"control": "wrong-demonstrations"}):
        with pytest.raises(SettingsError, match=r"have changed: Nearest \(code .*, 2 demonstrations\)"):
            evaluate("tests.helpers.agents:Nearest", **{**how, **other})
    more = evaluate("tests.helpers.agents:Nearest", **{**how, "tasks": "MoveToRegion,MoveToCorner"})
    assert len(more) == 2
    altered = (tmp_path / SETTINGS).read_text().replace(digest, "0" * 64)
    (tmp_path / SETTINGS).write_text(altered)
    with pytest.raises(SettingsError, match="demonstrations of MoveToRegion was"):
        evaluate("tests.helpers.agents:Nearest", **{**how, "tasks": "MoveToRegion,MoveToCorner"})


@pytest.mark.parametrize(
    ("policy", "settings", "error", "message"),
    [
        ("noop", {"demonstrations": 3}, SettingsError, "none of noop has it"),
        ("noop", {"control": "wrong-instruction"}, SettingsError, "uses_instruction = True"),
        (agents.Nearest, {"control": "wrong-instruction"}, SettingsError, "uses_instruction = True"),
        (agents.Nearest, {"control": "wrong-demonstrations", "shifts": "latency"}, SettingsError, "without shifts"),
        (agents.Nearest, {"control": "wrong-demonstrations", "wrap": "mine:Wrapper"}, SettingsError, "and wrappers"),
        (agents.Nearest, {"tasks": INTENT, "contrasting": True}, IntentError, "for several demo scenes"),
        (agents.Nearest, {"scenes": 9}, SettingsError, "8 demonstrations cannot be spread over 9 scenes"),
        (agents.Nearest, {"scenes": 2}, SettingsError, "MoveToRegion has one demo scene"),
        (agents.Nearest, {"contrasting": True}, SettingsError, "MoveToRegion has one demo scene"),
        (
            agents.Nearest,
            {"demonstrations": 26},
            DemonstrationError,
            "so no policy can receive 26",
        ),
        (agents.Nearest, {"tasks": INTENT, "demonstrations": 9, "scenes": 9}, IntentError, "demos=N from 1 to 8"),
    ],
)
def test_unsuitable_demonstrations_and_controls_are_refused(
    policy: Any, settings: dict[str, Any], error: type, message: str
) -> None:
    with pytest.raises(error, match=message):
        evaluate(policy, **{**DEMO, **settings})


def test_with_the_demonstrations_of_another_task_a_policy_pursues_that_one() -> None:
    (row,) = evaluate(
        agents.Nearest(), control="wrong-demonstrations", tasks="FindDupe", variants="Demo", episodes=1
    ).to_dict("records")
    assert (row["score"], row["other"], row["given"]) == (0.0, "FixColour", "another task's 8 demonstrations")
    assert np.isnan(row["other_score"])  # the other intent holds already at the start


class Reading:
    """Repeats a demonstration of FindDupe, and keeps the sentences and pictures that it receives."""

    uses_instruction = True
    preset = "LoResStack"

    def __init__(self) -> None:
        self.received: list[Any] = []

    def reset(self, episode: Episode) -> None:
        self._actions = iter(magical_mj.demos.load("FindDupe")[0].actions.tolist())
        self.received.append((episode.task, episode.instruction))

    def __call__(self, observation: Any) -> int:
        self.received.append((observation["ego"].tobytes(), observation["instruction"]))
        return next(self._actions, 0)


class ReadingForAll(Reading):
    """Does so for several episodes at once."""

    def reset_batch(self, episodes: Any) -> None:
        self.reset(episodes[0])

    def act_batch(self, observations: Any) -> list[int]:
        (picture,), (sentence,) = observations["ego"], observations["instruction"]
        return [self({"ego": picture, "instruction": sentence})]


@pytest.mark.parametrize("kind", [Reading, ReadingForAll])
def test_another_sentence_in_the_same_scene_and_pictures(kind: type[Reading]) -> None:
    own, other = kind(), kind()
    how = {**DEMO, "tasks": "FindDupe", "preset": "LoResStack", "name": "Reading"}
    (usual,) = evaluate(own, **how).to_dict("records")
    (row,) = evaluate(other, control="wrong-instruction", **how).to_dict("records")
    sentences = [task_spec(task).instruction for task in ("FindDupe", "ClusterColour")]
    assert [{sentence for _, sentence in policy.received} for policy in (own, other)] == [{text} for text in sentences]
    assert [first for first, _ in own.received] == [first for first, _ in other.received]
    scenes = magical_mj.demos.load("FindDupe")[0].scenes()
    reached = EIGHT["ClusterColour"].score(scenes[0], scenes[-1])
    assert (row["other"], row["other_score"]) == ("ClusterColour", pytest.approx(reached))
    assert (usual["given"], row["given"]) == ("instruction", "another task's instruction")
    assert (usual["score"], row["score"]) == (1.0, 1.0)


def test_no_other_task_can_be_pursued() -> None:
    with pytest.raises(SettingsError, match="no other task can be pursued in MoveToRegion Demo, seed 0"):
        evaluate(Reading(), preset="LoResStack", control="wrong-instruction", **DEMO)


def test_reports_group_methods_by_what_they_were_given(tmp_path: Path) -> None:
    plain = replace(TEMPLATE, task="FindDupe")
    given = replace(plain, given="8 demonstrations in 4 scenes", demonstrations="ab")
    control = replace(plain, given="another task's instruction", other="ClusterColour")
    switched = [
        replace(control, seed=seed, score=own, other_score=other)
        for seed, (own, other) in enumerate([(0, 1), (1, 1), (0, 0.5), (0, None)])
    ]
    folders = [write(tmp_path / name, rows) for name, rows in (("a", [plain]), ("b", [given]), ("c", switched))]
    data = results(folders)
    headings = ["nothing", "8 demonstrations in 4 scenes", "another task's instruction"]
    for table in result_tables(data)[:2]:
        assert [heading for heading, _ in table.groups] == [f"Given {what}" for what in headings]
    (table,) = control_tables(data)
    name = f"{TEMPLATE.policy}, another task's instruction"
    assert table.groups == (("", ((name, "0.25", "0.83", "0.33", "3"),)),)
    alone = results(folders[:1])
    assert [heading for heading, _ in result_tables(alone)[0].groups] == [""]
    assert [*control_tables(alone)] == []


def test_entries_with_demonstrations_at_test_say_so_and_have_a_block_of_their_own(tmp_path: Path) -> None:
    evaluate(agents.Nearest(), out=tmp_path / "run", **DEMO)
    card, path = tmp_path / "card.toml", tmp_path / "entry.json.xz"
    for declared in ("", "privileges = []\n"):
        card.write_text(declared)
        with pytest.raises((EvaluationError, SettingsError), match='add "demonstrations at test" to'):
            submit([tmp_path / "run"], path, card=card)
    card.write_text('privileges = ["demonstrations at test"]\n')
    submit([tmp_path / "run"], path, card=card)
    entry = read_entry(path)
    assert standing(entry).block == "given"
    (findings,) = check_entries({"entry": entry}, most=None, jobs=1).values()
    assert findings.episodes == len(entry.episodes) > 0
    assert findings.good
    evaluate(agents.Nearest(), out=tmp_path / "other", control="wrong-demonstrations", **DEMO)
    with pytest.raises(EvaluationError, match="as a control, with the demonstrations or the instruction of"):
        submit([tmp_path / "other"], tmp_path / "other.json.xz", card=card)


def test_policies_do_not_receive_the_intent_of_a_task(cache: Path) -> None:
    known: list[Episode] = []
    trained = Acting(reset=known.append, preset="State", tasks=[INTENT])
    reader = Acting(reset=known.append, preset="State", uses_instruction=True)
    for policy in (Acting(reset=known.append, preset="State"), reader, trained):
        evaluate(policy, tasks=INTENT, **DEMO)
    sentence = task_spec(INTENT).instruction
    assert [(episode.task, episode.instruction) for episode in known] == [
        (NEUTRAL, ""),
        (NEUTRAL, sentence),
        (INTENT, sentence),
    ]


def test_demonstrations_of_an_intent_in_several_scenes_are_made_once(cache: Path) -> None:
    how: dict[str, Any] = {"tasks": INTENT, "variants": "Demo", "demonstrations": 3, "scenes": 2}
    seen: list[tuple[int, int]] = []
    shown = demonstrations_given(EvaluationSettings(**how), lambda *numbers: seen.append(numbers))[INTENT]
    made = with_states(shown)
    assert digest_of(made) != digest_of(made[:2])
    assert [demo.scene for demo in made] == [*(scenes := task_spec(f"{INTENT} [demos=2]").demos), scenes[0]]
    assert all(demo.score == 1.0 for demo in made)
    assert seen == [(0, 3), (1, 3), (2, 3), (3, 3)]
    content = stored.default_path().read_bytes()
    rows = magical_mj.evaluate(agents.Nearest(), **how, episodes=2)
    assert rows["score"].iloc[0] == 1.0
    assert set(rows["given"]) == {"3 demonstrations in 2 scenes"}
    assert stored.default_path().read_bytes() == content


def test_the_other_intents_are_those_of_the_set() -> None:
    names = magical_mj.tasks.registry.listed_tasks("intent:dev")
    assert other_tasks(names[1]) == [*names[2:], names[0]]
    assert other_tasks(f"{names[1]} [demos=4]") == [f"{name} [demos=4]" for name in (*names[2:], names[0])]
    assert other_tasks("intent:robot wall(top) & line(all)")[0] == "intent:near corner(all, top left)"


@pytest.mark.parametrize(("chosen", "number", "environments"), [({}, 2, 500), ({"episodes": 100}, 100, 500)])
def test_the_official_evaluation_has_two_episodes_unless_another_number_is_given(
    chosen: dict[str, Any], number: int, environments: int
) -> None:
    settings = EvaluationSettings(tasks="intents", **chosen)
    assert (len(settings.seeds), len(settings.environments)) == (number, environments)
    assert len(EvaluationSettings(tasks="intent:seen").seeds) == 100


def test_the_test_sets_and_other_tasks_need_the_same_variants_and_episodes() -> None:
    for chosen in ({}, {"variants": "All"}, {"episodes": 2}):
        with pytest.raises(SettingsError, match=r"evaluate them apart, or give variants and episodes of both"):
            EvaluationSettings(tasks="intents,FindDupe", **chosen)
    settings = EvaluationSettings(tasks=iter(["intents", "FindDupe"]), variants="Layout,All", episodes=2)
    assert len(settings.environments) == 502


def test_an_error_in_an_intent_is_marked_at_its_place(shell: Shell, tmp_path: Path) -> None:
    text = "in(any, colour=red, regin)"
    _, _, error = shell("evaluate", "--policy", "noop", "--tasks", f"intent:{text}", "--out", tmp_path / "run")
    _, shown, mark = error.rstrip().splitlines()
    assert shown == text
    assert mark.index("^") == text.index("regin")


def test_on_the_command_line(tmp_path: Path, shell: Shell, cache: Path) -> None:
    code, out, error = shell(
        "evaluate",
        "--policy",
        "tests.helpers.agents:Nearest",
        "--tasks",
        INTENT,
        "--variants",
        "Demo",
        "--episodes",
        1,
        "--demonstrations",
        2,
        "--scenes",
        2,
        "--out",
        tmp_path / "run",
    )
    assert (code, error) == (0, "")
    assert "Nearest, 2 demonstrations in 2 scenes" in " ".join(out.split())
