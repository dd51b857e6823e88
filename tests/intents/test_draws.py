"""Stored draws: intents that are in no set are looked up in the user's cache folder."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from magical_mj.intents import parse
from magical_mj.intents.draws import Draws
from magical_mj.intents.names import TESTS, tasks_in
from magical_mj.intents.scenes import accepts, redrawn
from magical_mj.intents.tasks import Task, draws_of, found_draws, spec_of, with_further

SHOW = "import magical_mj; print(magical_mj.sample_scene('intent:line(colour=red) [seed=7]', 'Layout', 3).digest())"


def test_draws_of_other_intents_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    task = Task(parse("wall(colour=red, left) & robot wall(top)"), seed=5)
    spec = spec_of(task)
    (path,) = (tmp_path / "magical_mj").glob("intents-*.jsonl")
    (line,) = path.read_bytes().splitlines()
    assert msgspec.json.decode(line, type=Draws) == found_draws(task.intent, task.seed) == draws_of(task)
    assert spec_of(task).demo == spec.demo
    four = Task(task.intent, seed=5, demos=3, contrasting=True)
    further = spec_of(four).further_demos
    assert len(further) == 2
    assert spec_of(four).further_demos == further
    assert msgspec.json.decode(path.read_bytes().splitlines()[-1], type=Draws) == draws_of(four)


@pytest.mark.parametrize(("name", "number"), [("dev", 3), ("selector", 7), ("long", 49)])
@pytest.mark.parametrize("contrasting", [False, True])
def test_stored_demo_scenes_are_those_that_a_search_accepts(name: str, number: int, contrasting: bool) -> None:
    task = replace(tasks_in(name)[number], demos=3, contrasting=contrasting)
    stored = draws_of(task)
    searched = with_further(task, Draws(stored.task, stored.steps, stored.first))
    further = spec_of(task, searched).further_demos
    assert spec_of(task, stored).further_demos == further
    assert len(set(further)) == 2
    assert all(accepts(task.intent, scene) for scene in further)


@pytest.mark.parametrize("contrasting", [False, True])
def test_the_file_has_the_demo_scenes_of_test_sets(
    contrasting: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    for name in TESTS:
        for task in tasks_in(name):
            assert len(spec_of(replace(task, demos=4, contrasting=contrasting)).further_demos) == 3
    assert not list(tmp_path.iterdir())  # nothing had to be searched


def test_without_an_accepted_scene_a_demo_scene_repeats_the_first() -> None:
    intent = parse("in(colour=red, region) & untouched(others)")
    scene, rng = intent.spec().demo, np.random.Generator(np.random.PCG64(0))
    assert redrawn(intent, rng, scene, lambda _, __, scene: replace(scene, blocks=())) == scene


def test_a_cache_file_of_an_earlier_form_gives_the_same_scenes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "new"))
    task = Task(parse("in(shape=star, region)"), seed=77, demos=3)
    new = spec_of(task)
    (path,) = (tmp_path / "new" / "magical_mj").glob("intents-*.jsonl")
    draws = draws_of(task)
    old = {"task": draws.task, "steps": draws.steps, "first": draws.first, "random": [0, -1], "contrasting": [3, 2]}
    path.write_bytes(msgspec.json.encode(old) + b"\n")
    code = f"from magical_mj.tasks.registry import task_spec\nfor demo in task_spec('intent:{task}').demos: print(demo)"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert shown.splitlines() == [str(demo) for demo in new.demos]


def test_a_damaged_cache_gives_the_same_scenes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))

    def shown() -> str:
        return subprocess.run([sys.executable, "-c", SHOW], capture_output=True, text=True, check=True).stdout

    first = shown()
    (path,) = (tmp_path / "magical_mj").glob("intents-*.jsonl")
    path.write_bytes(b"\xff{not json\n" + path.read_bytes()[:-9])
    assert shown() == first
    path.parent.chmod(0o500)
    assert shown() == first
    path.parent.chmod(0o700)
