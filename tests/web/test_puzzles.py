"""Puzzles: intents that people play after two demonstrations, on the page, at the server and in a window."""

from __future__ import annotations

import json
from contextlib import closing

import pytest

import magical_mj
from magical_mj import Engine
from magical_mj.cli import main
from magical_mj.cli.play import Window
from magical_mj.intents import parse
from magical_mj.intents.names import tasks_in
from magical_mj.policies.interface import actions_of
from magical_mj.tasks.registry import task_spec
from magical_mj.web.puzzles import VARIANTS, goal_data, puzzle_of, puzzle_scenes, puzzles
from tests.helpers.commands import Shell

CHECKED = slice(0, None, 12)


def test_both_demonstrations_of_a_puzzle_solve_it_and_reach_its_rivals() -> None:
    assert {puzzle.intent for puzzle in puzzles()} <= {task.intent for task in tasks_in("dev")}
    for puzzle in puzzles()[CHECKED]:
        rivals = list(map(parse, puzzle.rivals))
        assert puzzle.intent not in rivals
        for seed, letters in enumerate(puzzle.demonstrations):
            with closing(Engine(puzzle.task, "Demo", seed=seed)) as engine:
                for action in actions_of(letters):
                    engine.step(action)
                assert engine.score() == 1.0, puzzle.task
                initial, final = engine.initial_scene, engine.scene
            assert all(rival.holds(initial, final) and not rival.holds(initial, initial) for rival in rivals)
            if rivals:
                assert puzzle.reached_instead(initial, final) == rivals[0]
            assert puzzle.reached_instead(initial, initial) is None


def test_the_data_of_a_puzzle_select_the_blocks_of_each_scene() -> None:
    puzzle = puzzle_of("intent:dev/0")
    assert puzzle in puzzles()
    for variant in VARIANTS:
        data = json.loads(json.dumps(puzzle_scenes(puzzle, variant)))
        assert data["puzzle"]["sentence"] == puzzle.intent.sentence
        for entry in data["scenes"]:
            scene = magical_mj.sample_scene(puzzle.task, variant, entry["seed"])
            first, second = entry["goal"]
            colours = [block.colour for block in scene.blocks]
            assert first["blocks"] == [index for index, colour in enumerate(colours) if colour != "yellow"]
            assert second["blocks"] == [index for index, colour in enumerate(colours) if colour == "blue"]
            assert colours[second["argument"]] == "yellow"
            assert all(rival["goal"] for rival in entry["rivals"])
    scene = magical_mj.sample_scene("MoveToCorner", "Demo", 0)
    assert goal_data(parse("in(all, region)"), scene) is None
    assert goal_data(parse("out(colour=yellow) & wall(all, left)"), magical_mj.sample_scene("FindDupe", "Demo", 0))


def test_an_intent_is_guessed_in_a_window(
    shell: Shell, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    puzzle, seen = puzzle_of("intent:dev/14"), list[list[str]]()
    steps = task_spec(puzzle.task).horizon()
    wishes = iter(["next", "next", *[None] * (steps + 2), "quit"])
    monkeypatch.setattr(Window, "wish", lambda _: next(wishes))
    monkeypatch.setattr(Window, "action", lambda _: 1)
    show = Window.show

    def look(window: Window, pictures: object, lines: list[str]) -> None:
        window._rate = 0  # as fast as possible
        seen.append(lines)
        show(window, pictures, lines)  # type: ignore[arg-type]

    monkeypatch.setattr(Window, "show", look)
    assert main(["guess", "intent:dev/14", "All", "--size", "48"]) == 0
    texts = [" ".join(lines) for lines in seen]
    assert ["Demonstration" in text for text in texts[:3]] == [True, True, False]
    during, after = texts[5], texts[-1]
    assert puzzle.intent.sentence not in during
    assert "score" not in during
    assert puzzle.intent.sentence in after
    assert "score" in after
    assert puzzle.intent.sentence in capsys.readouterr().out
    assert "guess is for intents" in shell.fails(2, "guess", "FindDupe")
