"""A study under attack, and on a machine whose disk is full or whose clock is wrong."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import magical_mj
from magical_mj import demos
from magical_mj.demos.recording import Recorder
from magical_mj.protocol import PROTOCOL
from magical_mj.utils.errors import DemonstrationError
from tests.helpers.limits import full_disk

pytest.importorskip("websockets")

from magical_mj.web.asking import question_data
from magical_mj.web.collection import ROOM, Collection
from magical_mj.web.server import PlayerSession, poses
from magical_mj.web.study import Study

QUOTA = 100
LAYOUT = Study({"MoveToRegion-Layout": QUOTA}, lease_minutes=20)


class Times:
    """A study's clock, which can be set, and its timer, which cannot."""

    def __init__(self) -> None:
        self.clock, self.timer = 1.8e9, 5000.0

    def pass_by(self, seconds: float) -> None:
        self.clock += seconds
        self.timer += seconds

    def study(self, folder: Path, study: Study = LAYOUT) -> Collection:
        return Collection(folder, study, lambda: self.clock, lambda: self.timer)


def offered(collection: Collection, person: str, address: str = "") -> tuple[str, str, int] | None:
    """The scene that a person is offered."""
    reply = collection.next(person, address)["next"]
    return reply and (reply["task"], reply["variant"], reply["seed"])


def begun(collection: Collection, person: str, address: str = "") -> bool:
    """Whether a person gets a scene, and may begin it."""
    scene = offered(collection, person, address)
    if scene is not None:
        collection.begin(person, scene)
    return scene is not None


def played(scene: tuple[str, str, int], action: int = 1) -> str:
    """The recording of an episode in a scene."""
    env = magical_mj.Engine(*scene[:2], seed=scene[2])
    recorder = Recorder(env)
    for _ in range(env.horizon or 0):
        recorder.step(action)
    about = dict(zip(("task", "variant", "seed"), scene, strict=True))
    numbers = {"actions": [action] * (env.horizon or 0), "final": poses(env.scene)}
    env.close()
    return json.dumps({"format": 1, "protocol": PROTOCOL, **about, **numbers})


def test_a_study_loses_nothing_on_a_full_disk_and_says_so_until_there_is_room(tmp_path: Path) -> None:
    collection = Collection(tmp_path, LAYOUT)
    ann, ben, eve = (collection.participant(None) for _ in range(3))
    first = offered(collection, ann)
    assert first is not None
    collection.begin(ann, first)
    second = offered(collection, ben)
    assert second is not None
    log = tmp_path / "study.jsonl"
    size = log.stat().st_size
    with full_disk(size + 20), pytest.raises(OSError, match=r"study\.jsonl"):
        collection.next(eve)  # whose offer does not fit
    assert log.stat().st_size == size, "no half of a line remains"
    with full_disk(ROOM // 2):  # there is room for an offer, but not for demonstrations
        assert "cannot be saved" in collection.next(eve)["why"]
        assert collection.status()["saves"] is False
        with pytest.raises(DemonstrationError, match="cannot be saved"):
            collection.begin(ben, second)
    with full_disk(3_000), pytest.raises(OSError, match="File too large"):
        collection.keep(played(first), ann, {})
    assert not demos.files_in(tmp_path)
    collection.keep(played(first), ann, {})  # there is room again
    assert collection.status()["saves"] is True
    assert begun(collection, eve)
    again = Collection(tmp_path, LAYOUT)
    assert offered(again, ben) == second
    assert again.status()["environments"][0] | {"histogram": 0} == {
        "environment": "MoveToRegion-Layout",
        "wanted": QUOTA,
        "accepted": 1,
        "leased": 1,
        "refused": {},
        "histogram": 0,
    }
    assert [path.name for path in tmp_path.glob(".*")] == []


def test_a_visitor_who_takes_many_scenes_keeps_nobody_from_playing(tmp_path: Path) -> None:
    times = Times()
    collection = times.study(tmp_path)
    greedy = [begun(collection, collection.participant(None), "203.0.113.7") for _ in range(500)]
    assert sum(greedy) == LAYOUT.per_address
    assert (tmp_path / "study.jsonl").read_bytes().count(b"\n") == 2 * LAYOUT.per_address
    others = [begun(collection, collection.participant(None), f"198.51.100.{number}") for number in range(200)]
    assert sum(others) == QUOTA - LAYOUT.per_address
    times.pass_by(21 * 60)
    assert begun(collection, collection.participant(None), "203.0.113.7")


def test_arrivals_that_never_act_reserve_nothing(tmp_path: Path) -> None:
    collection = Collection(tmp_path, Study({"MoveToRegion-Demo": 2}))
    idle, slow, quick, last = (collection.participant(None) for _ in range(4))
    scenes = {person: offered(collection, person) for person in (idle, slow)}
    assert len(set(scenes.values())) == 2, "different scenes as long as there are some"
    assert begun(collection, quick)
    assert begun(collection, last)
    assert scenes[slow] is not None
    with pytest.raises(DemonstrationError, match="others play all remaining scenes"):
        collection.begin(slow, scenes[slow])
    assert offered(collection, idle) is None


def test_a_clock_that_was_ahead_keeps_no_scene_for_longer_than_a_lease(tmp_path: Path) -> None:
    times = Times()
    one = Study({"MoveToRegion-Demo": 1}, lease_minutes=20)
    collection = times.study(tmp_path, one)
    times.clock += 30 * 86_400
    lost, other = collection.participant(None), collection.participant(None)
    assert begun(collection, lost)
    times.clock -= 30 * 86_400
    times.pass_by(10 * 60)
    assert not begun(collection, other)
    times.pass_by(11 * 60)
    assert begun(collection, other), "while the study runs"
    times.clock += 30 * 86_400
    times.pass_by(21 * 60)
    assert begun(collection, lost)
    times.clock -= 30 * 86_400
    again = times.study(tmp_path, one)
    assert not begun(again, other)
    times.pass_by(21 * 60)
    assert begun(again, other), "after a restart"


@pytest.mark.parametrize("speed", ["1" + "0" * 400, "1e999", "-Infinity", "NaN", "true", '"fast"', "[]"])
def test_an_odd_speed_is_recorded_as_unknown(tmp_path: Path, speed: str) -> None:
    collection = Collection(tmp_path, LAYOUT)
    session = PlayerSession([("MoveToRegion", "Layout")], collection)
    scene = json.loads(session.answer('{"arrive": null}'))["next"]
    recording = played((scene["task"], scene["variant"], scene["seed"]))
    answer = session.answer(f'{{"keep": {recording}, "about": {{"speed": {speed}}}}}')
    assert "score" in json.loads(answer)

    def refuse(name: str) -> Any:
        raise AssertionError(f"{name} is not JSON")

    lines = (tmp_path / "study.jsonl").read_text().splitlines()
    assert json.loads(lines[1], parse_constant=refuse)["speed"] is None


def test_a_connection_belongs_to_one_participant(tmp_path: Path) -> None:
    collection = Collection(tmp_path, LAYOUT)
    session = PlayerSession([("MoveToRegion", "Layout")], collection, address="203.0.113.7")
    replies = [json.loads(session.answer('{"arrive": null}')) for _ in range(100)]
    assert {reply["participant"] for reply in replies} == {replies[0]["participant"]}
    assert "another participant" in json.loads(session.answer('{"arrive": "0123456789abcdef"}'))["error"]
    with_scene = json.dumps({"open": {key: replies[0]["next"][key] for key in ("task", "variant", "seed")}})
    session.answer(with_scene)
    assert collection.status()["environments"][0]["leased"] == 0
    assert "poses" in json.loads(session.answer('{"act": 1}'))
    assert collection.status()["environments"][0]["leased"] == 1
    session.close()


def test_answers_to_questions_count_once_after_consent_and_without_the_solution(tmp_path: Path) -> None:
    study = Study({"MoveToRegion-Layout": QUOTA}, consent="Your answers are kept.", questions=1)
    collection = Collection(tmp_path, study)
    (asked,) = collection.questions.values()
    seat = PlayerSession([], collection)

    def ask(**message: Any) -> dict[str, Any]:
        return json.loads(seat.answer(json.dumps(message)))

    ask(arrive=None)
    given = {"answer": asked.answer, "question": asked.id, "seconds": 2.5}
    assert "consent" in ask(**given)["error"]
    ask(arrive=None, agree=True)
    assert ask(**given) == ask(answered=True) == {"answered": [asked.id]}
    assert ask(**given | {"answer": "B" if asked.answer == "A" else "A"}) == {"answered": [asked.id]}
    assert "letters" in ask(**given | {"answer": "E"})["error"]
    assert "does not ask" in ask(**given | {"question": "choose/dev/0/logic"})["error"]
    events = map(json.loads, (tmp_path / "study.jsonl").read_text().splitlines())
    (event,) = (event for event in events if event["event"] == "answered")
    assert (event["right"], event["answer"], event["seconds"]) == (True, asked.answer, 2.5)
    assert Collection(tmp_path, study).answered(event["participant"]) == {"answered": [asked.id]}
    shown = question_data(asked, answers=False)
    assert "readings" not in shown
    assert "answer" not in shown
    assert question_data(asked, answers=True)["answer"] == asked.answer
