"""Entries of the leaderboard: how they are made and grow, what they say, what is refused, and how they are checked."""

from __future__ import annotations

import dataclasses
import gzip
import hashlib
import json
import lzma
import os
import re
import shutil
import tomllib
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

import magical_mj
from magical_mj.evaluation.folder import SETTINGS
from magical_mj.leaderboard import read_entry, submit
from magical_mj.leaderboard.entry import MOST_UNPACKED, Card, Demonstrations, Training, entry_files, packed, unpacked
from magical_mj.leaderboard.page import HTML
from magical_mj.leaderboard.rerun import POLICIES, rerun, stored_policies
from magical_mj.leaderboard.standings import standing
from magical_mj.utils.errors import EvaluationError, SettingsError, UnknownNameError
from tests.helpers.agents import Slow
from tests.helpers.commands import Shell
from tests.helpers.entries import EPISODES, check, recorded, rewrite, whole

CARD = """
method = "Oracle"
links = ["https://example.org/oracle"]
hardware = "two cores"
[demonstrations]
set = 1
per_task = 10
[training]
hours = 1.5
"""


def test_an_entry_says_everything_and_checks(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "card.toml").write_text(CARD)
    path = tmp_path / "entry.json.xz"
    submitted = submit([folder], path, card=tmp_path / "card.toml")
    entry, findings = check(path, most=None)
    assert packed(entry) == packed(submitted) == path.read_bytes()
    assert (findings.episodes, findings.differing, findings.unfit) == (EPISODES, [], [])
    assert entry.card == Card(
        "Oracle",
        links=["https://example.org/oracle"],
        demonstrations=Demonstrations(set=1, per_task=10),
        training=Training(hours=1.5),
        hardware="two cores",
    )
    assert (entry.observations, entry.rules, entry.protocol, entry.runs) == (None, "paper", 1, [0])
    assert entry.versions.version == [magical_mj.__version__]
    with pytest.raises(FileExistsError):
        submit([folder], path)


def test_the_same_entry_has_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        submit([folder], tmp_path / f"{name}.json.xz")
        rewrite(folder, list.reverse)
    assert (tmp_path / "a.json.xz").read_bytes() == (tmp_path / "b.json.xz").read_bytes()


def content(path: Path) -> dict[str, Any]:
    return json.loads(lzma.decompress(path.read_bytes()))


def resealed(text: bytes) -> bytes:
    """The content of an entry with the proper hash."""
    without = re.sub(rb'"sha256":"[^"]*",', b"", text)
    return text.replace(re.findall(rb'"sha256":"([^"]*)"', text)[0], hashlib.sha256(without).hexdigest().encode())


def columns(environment: str = "FindDupe-All", **changed: list[Any]) -> dict[str, dict[str, list[Any]]]:
    """What a file holds of one episode."""
    episode = {"run": [0], "seed": [0], "scene": [None], "score": [0], "actions": [""], "failure": [None]}
    return {field: {environment: values} for field, values in {**episode, **changed}.items()}


ALTERED: list[tuple[dict[str, Any], str]] = [
    ({"rules": "released"}, "altered"),
    ({"rules": "mine"}, "rules"),
    ({"format": 1}, "format"),
    ({"surprise": 1}, "surprise"),
    ({"episodes": columns("FindDupe-Everything")}, "not an environment"),
    ({"episodes": columns("FindDupe-\x1b[2J")}, "not an environment"),
    ({"episodes": columns(score=[2])}, "score"),
    ({"episodes": columns(score=["NaN"])}, "score"),
    ({"episodes": columns(seed=[1.0])}, "seed"),
    ({"episodes": columns(score=[])}, "run 1, seed 1, scene 1, score 0"),
    ({"episodes": columns(seed=[0, 1])}, "run 1, seed 2, scene 1"),
    ({"episodes": {**columns(), "run": {"FindDupe-Demo": [0]}}}, "run 0, seed 1"),
    ({"observations": "\ud800"}, "not an entry"),
    ({"observations": "State |\n| **Planner ★**"}, "observations"),
]


def test_files_that_are_not_entries_are_named(folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "entry.json.xz"
    submit([folder], path)
    original = content(path)
    for change, problem in ALTERED:
        text = json.dumps({**original, **change}, sort_keys=True, separators=(",", ":")).encode()
        path.write_bytes(lzma.compress(resealed(text) if change != {"rules": "released"} else text))
        with pytest.raises(EvaluationError, match=problem):
            read_entry(path)
    text = json.dumps(original).encode().replace(b'"hours": null', b'"hours": 1e999')
    path.write_bytes(lzma.compress(text))
    with pytest.raises(EvaluationError, match="hours"):
        read_entry(path)


def test_damaged_files_are_named(tmp_path: Path) -> None:
    """And what is no plain file, and small files that expand to much, in bytes or in values."""
    damaged = {
        "empty": b"",
        "text": b"no",
        "half": lzma.compress(b"[1"),
        "list": lzma.compress(b"[]"),
        "cut": lzma.compress(b"{}")[:-1],
        "longer": lzma.compress(b"{}") + b"{}",
        "another format": gzip.compress(b"{}"),
        "bits": lzma.compress(b"{}")[:10] + b"\xff" * 20,
        "deep": lzma.compress(b"[" * 10**5),
        "bytes": lzma.compress(b" " * (MOST_UNPACKED + 1), preset=0),
        "values": lzma.compress(b"[],".join([b""] * 3_000_000), preset=0),
    }
    for name, data in damaged.items():
        (tmp_path / f"{name}.json.xz").write_bytes(data)
    os.mkfifo(tmp_path / "pipe.json.xz")
    (tmp_path / "device.json.xz").symlink_to("/dev/zero")
    problems = {"pipe": "plain file", "device": "plain file", "bytes": "60 MB", "values": "2,000,000 values"}
    for name in {**damaged, **problems}:
        with pytest.raises(EvaluationError, match=problems.get(name, rf"{name}\.json\.xz")):
            read_entry(tmp_path / f"{name}.json.xz")


def test_episodes_that_do_not_count_hide_none_that_do(tmp_path: Path) -> None:
    """A hundred lies among thousands of failures in other scenes; one lie is seen without being played."""
    lies = [recorded(0, "MoveToRegion", "Demo", seed, 0.7, "a" * 40) for seed in range(99)]
    lies.append(recorded(0, "MoveToRegion", "Demo", 99, 0.7, "a"))
    padding = [recorded(0, "MoveToRegion", "Demo", seed, 0.0, "", "no") for seed in range(100, 5_000)]
    (tmp_path / "entry.json.xz").write_bytes(packed(replace(whole(runs=1), episodes=[*lies, *padding])))
    findings = check(tmp_path / "entry.json.xz")[1]
    assert findings.episodes == 10
    assert len(findings.differing) == 11
    assert "run 0, MoveToRegion Demo, seed 99: it has 1 actions, but episodes have 40" in findings.differing


def test_a_random_part_is_checked(tmp_path: Path) -> None:
    """A tenth of 100 episodes that all lie; only who knows the seed can tell which."""
    episodes = [recorded(0, "MoveToRegion", "Demo", seed, 0.7, "a" * 40) for seed in range(100)]
    entry = replace(unpacked(packed(whole(runs=1))), episodes=episodes)
    (tmp_path / "entry.json.xz").write_bytes(packed(entry))
    first, again, *others = (check(tmp_path / "entry.json.xz", seed=seed)[1] for seed in (0, 0, 1, None, None))
    assert len(first.differing) == first.episodes == 10
    assert first.differing == again.differing
    assert len({tuple(sorted(findings.differing)) for findings in (first, *others)}) == 4


def test_an_entry_without_the_protocols_scenes_is_not_shown(tmp_path: Path) -> None:
    lone = recorded(0, "MoveToRegion", "Demo", 100, 0.0, "", "ValueError: no")
    (tmp_path / "entry.json.xz").write_bytes(packed(replace(whole(runs=1), episodes=[lone])))
    assert check(tmp_path / "entry.json.xz")[1].unfit == ["none of its episodes starts in the scenes of seeds 0 to 99"]


BAD: list[tuple[str, dict[str, Any], str]] = [
    ('colour = "red"', {}, "the card is not valid in .*card.toml: .*colour"),
    ("[training]\nhuors = 1", {}, "huors"),
    ("method =", {}, "cannot be read as TOML"),
    ("method = 2020-01-01", {}, "the card is not valid in .*card.toml.*method"),
    ('links = "https://example.org"', {}, "links"),
    ('training = "long"', {}, "training"),
    ("[training]\nhours = nan", {}, "hours"),
    ("", {"folders": []}, "give at least one folder"),
    ("", {"folders": "scores"}, "give a list of folders"),
    ("", {"policy": "nobody"}, "unknown policy 'nobody'"),
    ("", {"out": "entry.json"}, "must end in .json.xz"),
]


def test_bad_submissions_are_explained(folder: Path, tmp_path: Path) -> None:
    defaults = {"folders": [folder], "out": tmp_path / "entry.json.xz", "card": tmp_path / "card.toml"}
    for card, arguments, problem in BAD:
        (tmp_path / "card.toml").write_text(card)
        with pytest.raises((SettingsError, UnknownNameError), match=problem):
            submit(**{**defaults, **arguments})


def test_a_card_declares_what_its_policy_used(tmp_path: Path) -> None:
    """An agent that uses the simulation, but names a preset of pictures, as those do that look."""
    magical_mj.evaluate(
        Slow(), tasks="MoveToRegion", variants="Demo", episodes=1, preset="LoRes4E", jobs=1, out=tmp_path / "scores"
    )
    card = tmp_path / "card.toml"
    card.write_text("privileges = []")
    with pytest.raises(SettingsError, match='Slow uses the simulation during tests: add "simulator at test"'):
        submit([tmp_path / "scores"], tmp_path / "slow.json.xz", card=card)
    card.write_text('privileges = ["simulator at test"]')
    entry = submit([tmp_path / "scores"], tmp_path / "slow.json.xz", card=card)
    assert read_entry(tmp_path / "slow.json.xz").recorded == entry.recorded
    assert (entry.recorded.uses, entry.recorded.loaded) == (["simulation"], ["object"])
    assert entry.recorded.milliseconds
    assert entry.recorded.milliseconds > 1  # it sleeps as long
    altered = replace(entry, card=replace(entry.card, privileges=[]))
    assert "uses the simulation" in altered.undeclared


def test_policies_in_an_entry_play_fresh_scenes(tmp_path: Path, shell: Shell) -> None:
    """A network from the site, in MoveToRegion: it scores as recorded. A record of full scores is not its own."""
    network, entry = Path(__file__).parents[2] / "site" / "policies" / "MoveToRegion.onnx", tmp_path / "entry"
    played = {"tasks": "MoveToRegion", "variants": "Demo,Layout", "preset": "State", "jobs": 1}
    magical_mj.evaluate({"BC": network}, episodes=20, **played, out=tmp_path / "scores")
    submit([tmp_path / "scores"], entry / "0.json.xz")
    (entry / "card.toml").write_text('method = "BC"\nprivileges = ["states"]')
    own = read_entry(entry)
    assert (own.recorded.uses, own.recorded.loaded) == (["memory", "observations"], ["onnx"])
    assert stored_policies(entry) == []
    (entry / POLICIES).mkdir()
    shutil.copy(network, entry / POLICIES / "0-MoveToRegion.onnx")
    policies = stored_policies(entry)
    assert [(policy.run, policy.part) for policy in policies] == [(0, "MoveToRegion")]
    ((what, found),) = rerun(own, policies, first_seed=7, scenes=20, jobs=1).items()
    assert (what, found.decided) == ("1 task, 20 scenes in each environment", False)
    taped = replace(own, episodes=[dataclasses.replace(episode, score=1.0) for episode in own.episodes])
    (found,) = rerun(taped, policies, first_seed=7, scenes=20, jobs=1).values()
    assert found.high < 0
    with pytest.raises(EvaluationError, match="no policy of its runs for FixColour"):
        rerun(replace(own, episodes=[recorded(0, "FixColour", "Demo", 0, 1.0, "a")]), policies, first_seed=0)
    code, out, _ = shell("leaderboard", entry, "--rerun", "--seed", 7, "--scenes", 2, "--replay", 1)
    assert code == 0
    assert "entry: re-run in fresh scenes from 7 on: 1 task, 2 scenes in each environment: " in out
    assert "1 task, 2 scenes in each environment: " in (tmp_path / "out" / "leaderboard" / HTML).read_text()
    shutil.copy(network, entry / POLICIES / "0.onnx")
    with pytest.raises(EvaluationError, match=r"0-MoveToRegion.onnx and .*0.onnx are both run 0 in MoveToRegion"):
        stored_policies(entry)
    (entry / POLICIES / "0.onnx").rename(entry / POLICIES / "best.onnx")
    with pytest.raises(EvaluationError, match=r"best.onnx must be a model .* and named RUN, RUN-TASK or RUN-intents"):
        stored_policies(entry)


@pytest.mark.weekly
def test_the_policies_of_our_entry_score_the_same_in_fresh_scenes() -> None:
    folder = Path(__file__).parents[2] / "results" / "state-bc"
    policies = stored_policies(folder)
    assert [(policy.run, policy.part) for policy in policies] == [(5, task) for task in sorted(magical_mj.TASKS)]
    entry = read_entry(folder)
    found = rerun(entry, policies, first_seed=0)
    assert [one.decided for one in found.values()] == [False]
    assert standing(entry, found).kind == "official"


def test_a_protocol_that_is_no_number_is_explained(folder: Path, tmp_path: Path) -> None:
    settings = json.loads((folder / SETTINGS).read_text())
    for number in ([1], "1", True, 0):
        (folder / SETTINGS).write_text(json.dumps({**settings, "protocol": number}))
        with pytest.raises(EvaluationError, match=r"the choice of folders is not an entry: .*protocol"):
            submit([folder], tmp_path / "entry.json.xz")
    assert not list(tmp_path.glob("entry*"))


def test_folders_that_cannot_be_an_entry_are_explained(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(EvaluationError, match=r"holds an episode twice: .* again with another --run"):
        submit([folder, shutil.copytree(folder, tmp_path / "again")], tmp_path / "entry.json.xz")
    training = tmp_path / "training"
    training.mkdir()
    (training / "policy.safetensors").touch()
    with pytest.raises(EvaluationError, match=r"holds a policy: .* --policy .*training --out ANOTHER"):
        submit([training], tmp_path / "entry.json.xz")
    rewrite(folder, lambda rows: rows[0].update(preset="LoRes4E"))
    with pytest.raises(EvaluationError, match="different preset"):
        submit([folder], tmp_path / "entry.json.xz")
    rewrite(folder, lambda rows: rows[0].update(preset=None, task="PushOut"))
    with pytest.raises(EvaluationError, match="PushOut"):
        submit([folder], tmp_path / "entry.json.xz")
    rewrite(folder, lambda rows: rows[0].update(policy="bc-1"))
    with pytest.raises(SettingsError, match=r"bc-1, expert: .*--policy NAME.*--policy BC=runs/a,BC=runs/b"):
        submit([folder], tmp_path / "entry.json.xz")
    rewrite(folder, lambda rows: [row.update(shift="mine:Fog:3") for row in rows])
    with pytest.raises(EvaluationError, match="all episodes have shifts"):
        submit([folder], tmp_path / "entry.json.xz")
    assert not (tmp_path / "entry.json.xz").exists()


def test_one_training_is_one_run(folder: Path, tmp_path: Path) -> None:
    """The file of a policy, evaluated twice, is recorded with the same hash."""
    settings = json.loads((folder / SETTINGS).read_text())
    settings["policies"] = [{"name": "expert", "run": run, "origin": "a", "sha256": "c0ffee"} for run in (0, 1)]
    (folder / SETTINGS).write_text(json.dumps(settings))
    with pytest.raises(EvaluationError, match=r"the runs 0, 1 of expert have equal policies \(sha256 c0ffee"):
        submit([folder], tmp_path / "entry.json.xz")


def test_files_of_an_entry_are_of_one_kind(folder: Path, tmp_path: Path) -> None:
    submit((path for path in [folder]), tmp_path / "mine" / "0.json.xz")
    (tmp_path / "mine" / "card.toml").write_text('method = "Mine"\n')
    for name, value in (("rules", "released"), ("preset", "LoRes4A")):
        rewrite(folder, lambda rows: [row.update({"run": 1, name: value}) for row in rows])  # noqa: B023
        submit([folder], tmp_path / "mine" / "1.json.xz")
        with pytest.raises(EvaluationError, match=f"different .*, {value} in .*they must be the same"):
            read_entry(tmp_path / "mine")
        (tmp_path / "mine" / "1.json.xz").unlink()
        rewrite(folder, lambda rows: [row.update({"run": 1, "rules": "paper"}) for row in rows])


def test_a_run_is_added_as_a_file(folder: Path, tmp_path: Path) -> None:
    """A folder's card counts, its files are read together, and no episode stands in two of them."""
    submit([folder], tmp_path / "mine" / "0.json.xz")
    (tmp_path / "mine" / "card.toml").write_text('method = "Mine"\nprivileges = ["simulator at test"]\n')
    rewrite(folder, lambda rows: [row.update(run=1) for row in rows])
    submit([folder], tmp_path / "mine" / "1.json.xz")
    assert entry_files(tmp_path) == entry_files(tmp_path / "mine") == [tmp_path / "mine"]
    entry = read_entry(tmp_path / "mine")
    assert (entry.method, entry.runs, len(entry.episodes)) == ("Mine", [0, 1], 2 * EPISODES)
    assert (standing(entry).block, standing(read_entry(tmp_path / "mine" / "0.json.xz")).block) == (
        "simulator",
        "undeclared",
    )
    (tmp_path / "mine" / "2.json.xz").write_bytes((tmp_path / "mine" / "1.json.xz").read_bytes())
    with pytest.raises(EvaluationError, match=r"2\.json\.xz and another file of .* hold the same episode"):
        read_entry(tmp_path / "mine")
    (tmp_path / "mine" / "card.toml").write_text('method = "Mine"\nprivileges = ["magic"]\n')
    with pytest.raises(EvaluationError, match=r"card\.toml is not a card: .*magic"):
        read_entry(tmp_path / "mine")


def test_our_entries_declare_their_privileges() -> None:
    results = Path(__file__).parents[2] / "results"
    cards = [tomllib.loads(path.read_text()) for path in results.glob("*/card.toml")]
    assert len(cards) == len(entry_files(results)) > 20
    assert all("privileges" in card for card in cards)
