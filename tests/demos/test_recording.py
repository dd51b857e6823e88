"""Recording demonstrations: from people, from experts, and from the files of a browser, in which little may stand."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import magical_mj
from magical_mj import demos
from magical_mj.actions import ACTIONS
from magical_mj.cli import main
from magical_mj.demos.recording import MAX_BYTES
from magical_mj.protocol import PROTOCOL
from magical_mj.utils.errors import DemonstrationError, InvalidSeedError, MagicalError, StateError
from tests.helpers.commands import Shell


def test_actions_may_be_recorded_as_triples() -> None:
    env = magical_mj.Engine("MoveToRegion", seed=0)
    env.reset()
    recorder = demos.Recorder(env)
    for action in (ACTIONS[0], ACTIONS[10], 3):
        recorder.step(action)
    assert recorder.demonstration("human").actions.tolist() == [0, 10, 3]


def test_an_episode_is_recorded_from_its_start_to_its_end() -> None:
    env = magical_mj.Engine("MoveToRegion", seed=0)
    env.reset()
    recorder = demos.Recorder(env)
    for _ in range(env.horizon or 0):
        recorder.step(0)
    with pytest.raises(StateError, match="the episode is over"):
        recorder.step(0)
    demo = recorder.demonstration("expert", np.int64(3))  # pyright: ignore[reportArgumentType]
    assert len(demo.actions) == env.horizon
    assert (demo.scene_seed, demo.seed) == (0, 3)
    assert type(demo.seed) is int
    env.reset()
    env.step(1)
    with pytest.raises(DemonstrationError, match="the episode began 1 steps ago"):
        demos.Recorder(env)


def test_episodes_that_were_not_fully_recorded_are_refused() -> None:
    """Not episodes that were stepped or begun anew without it, and not those that began in a scene of no seed."""
    env = magical_mj.Engine("ClusterShape", "Layout", seed=5, rules="released")
    env.reset()
    recorder = demos.Recorder(env)
    recorder.step(0)
    demo = recorder.demonstration("human")
    assert (demo.task, demo.variant, demo.scene_seed, demo.seed) == ("ClusterShape", "Layout", 5, 5)
    assert demo.score == demo.rescored()  # by the paper's rules, whatever those of the environment are
    for elsewhere in (lambda: env.step(1), env.reset):
        elsewhere()
        for use in (lambda: recorder.step(1), lambda: recorder.demonstration("human")):
            with pytest.raises(DemonstrationError, match="changed without the recorder"):
                use()
    env.reset(scene=demo.scene)
    with pytest.raises(DemonstrationError, match="seed"):
        demos.Recorder(env).demonstration("human")


def test_numbers_of_numpy_are_seeds_too(tmp_path: Path) -> None:
    demo = demos.demonstrate("MoveToRegion", "Demo", np.int64(3))  # pyright: ignore[reportArgumentType]
    demos.write(demo, tmp_path / "a.npz")
    assert demos.read(tmp_path / "a.npz").scene_seed == 3
    with pytest.raises(InvalidSeedError, match="is not a seed"):
        demos.demonstrate("MoveToRegion", "Demo", -1)


def test_a_score_that_no_expert_reaches_is_an_error() -> None:
    with pytest.raises(DemonstrationError, match=r"10 experts tried MoveToRegion-Demo .*; the best reached 1\.00"):
        demos.demonstrate("MoveToRegion", "Demo", 0, least_score=1.5)


def poses(scene: magical_mj.Scene) -> dict[str, Any]:
    robot = scene.robot
    return {
        "robot": [robot.x, robot.y, robot.angle],
        "fingers": list(robot.fingers),
        "blocks": [[block.x, block.y, block.angle] for block in scene.blocks],
    }


def recording(task: str, variant: str, seed: int) -> dict[str, Any]:
    """What the page saves of an episode of random actions."""
    env = magical_mj.Engine(task, variant)
    env.reset(seed=seed)
    actions = np.random.default_rng(seed).integers(18, size=env.horizon).tolist()
    for action in actions:
        env.step(action)
    final = poses(env.scene)
    env.close()
    names = {"format": 1, "protocol": PROTOCOL, "task": task, "variant": variant, "seed": seed}
    return {**names, "actions": actions, "final": final}


@pytest.fixture(scope="module")
def saved() -> dict[str, Any]:
    return recording("FindDupe", "All", 3)


def test_a_recording_becomes_a_demonstration(saved: dict[str, Any]) -> None:
    demo, deviation, suspect = demos.from_recording(json.dumps(saved | {"score": 1.0, "scene": "ignored"}))
    assert (demo.task, demo.variant, demo.scene_seed, demo.demonstrator) == ("FindDupe", "All", 3, "human")
    assert demo.scene == magical_mj.sample_scene("FindDupe", "All", 3)
    assert demo.actions.tolist() == saved["actions"]
    assert demo.score == demo.rescored()
    assert demos.verify(demo).exact
    assert deviation == 0.0
    assert not suspect


def test_another_end_than_the_player_saw_is_flagged(saved: dict[str, Any]) -> None:
    x, y, angle = saved["final"]["blocks"][2]
    for shift, suspect in ((5e-4, False), (2e-3, True)):
        blocks = saved["final"]["blocks"].copy()
        blocks[2] = [x, y + shift, angle]
        imported = demos.from_recording(json.dumps(saved | {"final": saved["final"] | {"blocks": blocks}}))
        assert imported.deviation == pytest.approx(shift)
        assert imported.suspect == suspect
    without = {key: value for key, value in saved.items() if key != "final"}
    assert demos.from_recording(json.dumps(without)).deviation is None


REFUSED: dict[str, tuple[dict[str, Any], str]] = {  # types are msgspec's matter
    "another format": ({"format": 2}, "format"),
    "no format": ({"format": None}, "format"),
    "another protocol": ({"protocol": PROTOCOL + 1}, f"protocol {PROTOCOL}"),
    "unknown task": ({"task": "FindDup"}, "Did you mean 'FindDupe'"),
    "unknown variant": ({"variant": "Color"}, "Did you mean 'Colour'"),
    "impossible pair": ({"task": "MoveToCorner", "variant": "Layout", "actions": [1] * 80}, "It has"),
    "code as task": ({"task": "os:system"}, "task"),
    "path as variant": ({"variant": "/etc/passwd"}, "variant"),
    "endless name": ({"task": "F" * 50_000}, "task"),
    "newline in a name": ({"task": "FindDupe\n"}, "task"),
    "negative seed": ({"seed": -1}, "seed"),
    "huge seed": ({"seed": 10**400}, "seed"),
    "another action": ({"actions": [18] * 100}, "actions"),
    "truth as action": ({"actions": [True] * 100}, "actions"),
    "half an episode": ({"actions": [1] * 50}, "has 100 actions"),
    "a million actions": ({"actions": [1] * 10**6}, "bytes"),
    "final without blocks": ({"final": {"robot": [0, 0, 0], "fingers": [0, 0]}}, "blocks"),
    "final of other blocks": ({"final": {"robot": [0, 0, 0], "fingers": [0, 0], "blocks": []}}, "final"),
    "final with a huge number": ({"final": {"robot": [10**400, 0, 0], "fingers": [0, 0], "blocks": []}}, "final"),
}


def test_recordings_that_do_not_fit_are_refused(saved: dict[str, Any]) -> None:
    for change, hint in REFUSED.values():
        with pytest.raises(MagicalError, match=hint):
            demos.from_recording(json.dumps(saved | change))


def test_texts_that_are_not_recordings_are_refused() -> None:
    contents: tuple[Any, ...] = (
        *(b"", b"\xff\xfe\x00", b"[" * (MAX_BYTES - 1), b'{"deep": ' + b"[" * (MAX_BYTES - 9), b"[]", b"null"),
        *(b'{"format": 1', b'{"format": NaN}', b'{"seed": ' + b"9" * 5000 + b"}", b" " * (MAX_BYTES + 1)),
        *(None, 5, ["{}"], {"format": 1}, Path("played.json")),
    )
    for content in contents:
        with pytest.raises(DemonstrationError, match="recording"):
            demos.from_recording(content)


def test_finals_of_infinite_numbers_are_refused(saved: dict[str, Any]) -> None:
    text = json.dumps(saved).replace('"robot": [', '"robot": [1e999, ', 1)
    with pytest.raises(DemonstrationError, match="final"):
        demos.from_recording(text)


@pytest.mark.parametrize("content", [b"{}", b" " * (MAX_BYTES + 1), None])
def test_nothing_is_imported_if_a_file_is_bad(saved: dict[str, Any], content: bytes | None, shell: Shell) -> None:
    Path("good.json").write_text(json.dumps(saved))
    if content is None:
        Path("bad.json").symlink_to("/dev/zero")
    else:
        Path("bad.json").write_bytes(content)
    assert "bad.json" in shell.fails(2, "demos", "import", "good.json", "bad.json", "--out", "made")
    assert not Path("made").exists()


def test_the_command_imports_each_file_once(
    saved: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = recording("MoveToRegion", "Demo", 0)
    for name, content in (
        ("a.json", saved),
        ("b.json", other | {"final": poses(magical_mj.sample_scene("MoveToRegion", "Demo", 1))}),
    ):
        (tmp_path / name).write_text(json.dumps(content))
    files = [str(tmp_path / name) for name in ("a.json", "b.json", "a.json")]
    made = tmp_path / "made"
    assert main(["demos", "import", *files, "--out", str(made)]) == 0
    out = capsys.readouterr().out
    names = ["FindDupe-All-human-000.npz", "MoveToRegion-Demo-human-000.npz"]
    assert sorted(path.name for path in made.iterdir()) == names
    first, second, third, summary = out.splitlines()
    assert names[0] in first
    assert "from what the player saw" in second
    assert "was imported already" in third
    assert summary == "0 of 3 episodes have score 1"
    assert main(["demos", "import", *files, "--out", str(made)]) == 0
    assert sorted(path.name for path in made.iterdir()) == names
    assert main(["demos", "verify", str(made), "--jobs", "1"]) == 0


def test_folders_of_several_people_are_read_and_no_file_twice(
    saved: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    demo = demos.from_recording(json.dumps(saved)).demonstration
    for person in ("one", "two"):
        path, _ = demos.keep(demo, tmp_path / person)
    (tmp_path / "token").write_text("secret")
    demos.keep(demo, tmp_path / ".old")  # hidden, and so not read
    assert len(demos.load("FindDupe", tmp_path)) == 2
    demos.write(demos.load("FixColour")[0], tmp_path / "FixColour-Demo-000.npz")  # which hides nobody's
    assert main(["demos", "info", str(tmp_path), "--tasks", "FindDupe"]) == 0
    (row,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("FindDupe-")]
    assert row.split()[2] == "2"
    (tmp_path / "FixColour-Demo-000.npz").unlink()
    assert main(["demos", "verify", str(tmp_path), str(path), str(path.parent), "--jobs", "1"]) == 0
    assert "2 of 2 replay" in capsys.readouterr().out
    assert main(["demos", "export", str(tmp_path), "--out", str(path.with_name("x.npz")), "--preset", "State"]) == 2
    assert "would be in the folder of the demonstrations" in capsys.readouterr().err
