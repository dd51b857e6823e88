# ruff: noqa: E402 - imports after the check that Inspect is installed
"""The tasks of Inspect, with models that are servers on the loopback address and answer by rule."""

from __future__ import annotations

import gc
import json
import re
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest

inspect_ai = pytest.importorskip(
    "inspect_ai", reason="inspect_ai is missing: make integrations-test LIBRARY=inspect_ai"
)

from inspect_ai.log import EvalLog
from inspect_ai.model import ChatMessageUser

from magical_mj.integrations.inspect_ai import act, choose, place, say
from magical_mj.integrations.inspect_ai.content import contents
from magical_mj.intents.plans import plan
from magical_mj.intents.question import Question, questions
from magical_mj.intents.question_text import prompt
from magical_mj.policies.interface import actions_of
from magical_mj.scene import Scene
from magical_mj.tasks.planning import Noise

pytestmark = pytest.mark.filterwarnings("default")  # Inspect's own
KEY = "secret-key-of-this-test"
Reply = dict[str, Any] | bytes | int
Rule = Callable[[dict[str, Any]], Reply]


def said(text: str) -> Reply:
    return {"role": "assistant", "content": text}


def called(name: str, **arguments: Any) -> Reply:
    function = {"name": name, "arguments": json.dumps(arguments)}
    return {"role": "assistant", "content": None, "tool_calls": [{"id": "1", "type": "function", "function": function}]}


@contextmanager
def serving(rule: Rule) -> Iterator[str]:
    """A server that speaks the protocol of OpenAI, and its address."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            reply = rule(body)
            if isinstance(reply, dict):
                reason = "tool_calls" if "tool_calls" in reply else "stop"
                reply = json.dumps(
                    {
                        "id": "1",
                        "object": "chat.completion",
                        "created": 0,
                        "model": body["model"],
                        "usage": {"prompt_tokens": 1, "completion_tokens": 1, "total_tokens": 2},
                        "choices": [{"index": 0, "finish_reason": reason, "message": reply}],
                    }
                ).encode()
            self.send_response(reply if isinstance(reply, int) else 200)
            data = b"{}" if isinstance(reply, int) else reply
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(data)))
            self.end_headers()
            self.wfile.write(data)

        def log_message(self, *_: Any) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/v1"
        server.shutdown()
        thread.join()


def evaluated(task: Any, rule: Rule, folder: Path, **settings: Any) -> EvalLog:
    settings = {"max_retries": 0, "fail_on_error": False} | settings
    with serving(rule) as address:
        model = inspect_ai.model.get_model("openai-api/local/rule", base_url=address, api_key=KEY)
        (log,) = inspect_ai.eval(task, model=model, display="none", log_dir=str(folder), **settings)
    gc.collect()  # Inspect leaves streams open, whose warnings should not reach other tests
    return log


def values(log: EvalLog, name: str) -> list[float]:
    return [sample.scores["judged"].as_dict()[name] for sample in log.samples or () if sample.scores]


def text_of(body: dict[str, Any]) -> str:
    """The text of a conversation's first message."""
    content = body["messages"][0]["content"]
    return content if isinstance(content, str) else "\n".join(part.get("text", "") for part in content)


def asked(question: Question) -> str:
    parts = [content for part in prompt(question) for content in contents(part, "text")]
    return ChatMessageUser(content=parts).text


def knowing(made: list[Question], answer: Callable[[Question, dict[str, Any]], Reply]) -> Rule:
    """A rule that recognises questions by their text."""
    known = {"".join(asked(question).split()): question for question in made}
    return lambda body: answer(known["".join(text_of(body).split())], body)


def test_always_the_first_option_is_right_for_a_quarter_of_the_questions(tmp_path: Path) -> None:
    log = evaluated(choose(set="dev", limit=12, scenes=1), lambda _: said("I choose the first.\nANSWER: A"), tmp_path)
    assert len(values(log, "right")) == 12
    mean = sum(values(log, "right")) / 12
    right = metrics(log, "right")
    assert right["dev prior"] == mean == metrics(log, "intended")["dev prior"]
    assert right["dev prior lower"] < 0.25 < right["dev prior upper"]


def metrics(log: EvalLog, name: str) -> dict[str, float]:
    """The metrics of a score by set."""
    assert log.results
    (found,) = (score.metrics for score in log.results.scores if score.name == name)
    return {key.rpartition("by_set_")[2]: metric.value for key, metric in found.items()}


def test_one_who_knows_the_answers_scores_1_in_choose(tmp_path: Path) -> None:
    rule = knowing(list(questions("choose", scenes=2, limit=2)), lambda question, _: said(f"ANSWER: {question.answer}"))
    assert values(evaluated(choose(scenes=2, limit=2), rule, tmp_path), "right") == [1.0] * 2


def test_one_who_knows_the_intents_scores_1_in_say(tmp_path: Path) -> None:
    rule = knowing(list(questions("say", limit=1)), lambda question, _: said(f"ANSWER: {question.answer}"))
    log = evaluated(say(limit=1), rule, tmp_path)
    assert values(log, "agreement") == values(log, "exact") == [1.0]


def moved(question: Question) -> dict[int, tuple[float, float]]:
    final = Scene.from_json(question.answer)
    pairs = enumerate(zip(question.scene.blocks, final.blocks, strict=True), 1)
    return {number: (end.x, end.y) for number, (start, end) in pairs if (start.x, start.y) != (end.x, end.y)}


def robot_of(question: Question) -> tuple[float, float]:
    robot = Scene.from_json(question.answer).robot
    return robot.x, robot.y


def test_one_who_knows_final_poses_scores_1_in_place(tmp_path: Path) -> None:
    def answer(question: Question, _: dict[str, Any]) -> Reply:
        return said(f"ANSWER: {json.dumps({'blocks': moved(question), 'robot': robot_of(question)})}")

    log = evaluated(place(limit=4), knowing(list(questions("place", limit=4)), answer), tmp_path)
    assert values(log, "right") == values(log, "clean") == [1.0] * 4


def seen(question: Question, body: dict[str, Any]) -> Scene:
    """The scene as the last answer of a tool describes it."""
    text = next((str(one["content"]) for one in reversed(body["messages"]) if one["role"] == "tool"), "")
    places = re.findall(r"^(robot|block \d+).* at \((-?[\d.]+), (-?[\d.]+)\)", text, re.MULTILINE)
    if not places:
        return question.scene
    (_, *robot), *blocks = places
    poses = [(float(x), float(y), block.angle) for (_, x, y), block in zip(blocks, question.scene.blocks, strict=True)]
    return question.scene.moved((float(robot[0]), float(robot[1]), 0.0), poses)


def test_one_who_knows_the_intents_and_plans_after_each_move_scores_1_in_act(tmp_path: Path) -> None:
    def answer(question: Question, body: dict[str, Any]) -> Reply:
        scene = seen(question, body)
        if question.intent.holds(question.scene, scene):
            return called("done", answer="")
        todo = plan(question.intent, question.scene, scene, Noise(np.random.default_rng(0), 0.0))
        first = min(todo, key=lambda subgoal: subgoal.cost(scene))
        x, y = first.target
        return called("drive", x=x, y=y) if first.block is None else called("move", block=first.block + 1, x=x, y=y)

    rule = knowing(list(questions("act", "combined", scenes=1, limit=2)), answer)
    log = evaluated(act(set="combined", scenes=1, limit=2), rule, tmp_path)
    assert values(log, "right") == values(log, "clean") == [1.0] * 2


@pytest.mark.parametrize(
    "text", ["", "I cannot help with that.", "ANSWER: E", "ANSWER:", "{" * 100_000, "A" * 1_000_000]
)
def test_answers_that_cannot_be_read_are_wrong(text: str, tmp_path: Path) -> None:
    log = evaluated(choose(limit=1, scenes=1), lambda _: said(text), tmp_path)
    assert values(log, "right") == [0.0]
    assert log.samples
    assert log.samples[0].scores
    assert log.samples[0].scores["misread"].as_dict()["no answer"] == 1.0


def test_places_that_are_nonsense_are_wrong(tmp_path: Path) -> None:
    texts = iter(
        ['ANSWER: {"blocks": {"99": [0, 0]}}', 'ANSWER: {"blocks": {"1": [NaN, 0]}}', "ANSWER: {}", "ANSWER: [[["]
    )
    log = evaluated(place(limit=4), lambda _: said(next(texts)), tmp_path, max_connections=1)
    assert values(log, "right") == [0.0] * 4


def test_a_second_answer_repairs_a_text_with_an_error(tmp_path: Path) -> None:
    intents = {question.id: question.answer for question in questions("say", limit=1)}

    def rule(body: dict[str, Any]) -> Reply:
        if len(body["messages"]) == 1:
            return said("ANSWER: in(colour=purple, region)")
        assert "^" in body["messages"][-1]["content"]  # the position of the error
        return said(f"ANSWER: {intents['say/dev/0']}")

    assert values(evaluated(say(limit=1), rule, tmp_path), "exact") == [1.0]


def test_a_server_error_is_no_score(tmp_path: Path) -> None:
    log = evaluated(choose(limit=1, scenes=1), lambda _: 500, tmp_path)
    assert not values(log, "right")
    assert log.samples
    assert log.samples[0].error


def test_a_server_that_does_not_answer_is_no_score(tmp_path: Path) -> None:
    def rule(_: dict[str, Any]) -> Reply:
        time.sleep(3)
        return said("ANSWER: A")

    log = evaluated(choose(limit=1), rule, tmp_path, attempt_timeout=1)
    assert not values(log, "right")


def test_logs_contain_no_key(tmp_path: Path) -> None:
    evaluated(choose(limit=1, scenes=1), lambda _: said("ANSWER: A"), tmp_path, log_format="json")
    (file,) = tmp_path.glob("*.json")
    assert KEY not in file.read_text()


def test_pictures_reach_the_model(tmp_path: Path) -> None:
    seen = list[str]()

    def rule(body: dict[str, Any]) -> Reply:
        seen.extend(part["type"] for part in body["messages"][0]["content"])
        return said("ANSWER: A")

    evaluated(choose(limit=1, scenes=1, form="pictures"), rule, tmp_path)
    assert seen.count("image_url") == 2 + 1 + 4


def command(*arguments: object) -> tuple[int, str]:
    """The exit code and the output of `python -m magical_mj.integrations.inspect_ai`."""
    program = [sys.executable, "-W", "ignore", "-m", "magical_mj.integrations.inspect_ai", *map(str, arguments)]
    result = subprocess.run(program, capture_output=True, text=True, check=False)
    return result.returncode, result.stdout + result.stderr


def test_episodes_of_act_become_an_evaluation_with_the_same_results(tmp_path: Path) -> None:
    calls = iter([called("move", block=1, x=0.5, y=0.5), called("done", answer="")])
    log = evaluated(act(limit=1), lambda _: next(calls), tmp_path / "logs")
    code, out = command("episodes", tmp_path / "logs", "--out", tmp_path / "played")
    assert code == 0, out
    (line,) = (tmp_path / "played" / "scores.jsonl").read_text().splitlines()
    assert (json.loads(line)["score"] == 1.0) == (values(log, "right") == [1.0])
    (sample,) = log.samples or ()
    assert sum(action != 0 for action in json.loads(line)["actions"]) > 0
    assert sample.store["actions"] == actions_of(json.loads(line)["actions"])[: len(sample.store["actions"])]


def test_episodes_in_other_scenes_are_refused(tmp_path: Path) -> None:
    evaluated(act(limit=1, seed=1), lambda _: called("done", answer=""), tmp_path / "logs")
    code, out = command("episodes", tmp_path / "logs", "--out", tmp_path / "played")
    assert code == 2
    assert "another seed" in out


def test_the_shares_of_what_answers_follow_are_printed(tmp_path: Path) -> None:
    log = evaluated(choose(limit=4, scenes=1), lambda _: said("ANSWER: A"), tmp_path)
    code, out = command("misread", tmp_path)
    assert code == 0, out
    assert log.samples
    scores = [sample.scores["misread"].as_dict() for sample in log.samples if sample.scores]
    named = Counter(kind for score in scores for kind, flag in score.items() if flag)
    assert named.total() == 4
    for kind, count in named.items():
        assert re.search(rf"dev prior .*{kind} .*{count / 4:.2f} .*{count} of 4", out)
    assert "1 of 1" in out  # of the questions about an intent, those that were taken for a reading
