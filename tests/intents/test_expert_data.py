"""Data sets of intents: made once by the expert, continued after an interruption, and exported."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tarfile
import time
from pathlib import Path

import numpy as np
import pytest

import magical_mj
from magical_mj.demos import stored
from magical_mj.intents import dataset, parse
from magical_mj.intents.expert_data import FILE
from magical_mj.tasks.registry import sample_scene, task_spec
from magical_mj.utils.errors import DemonstrationError, IntentError, SettingsError, UnknownNameError
from tests.helpers.commands import Shell
from tools.intents import wanted

TEXTS = ("robot in()", "wall(any, all, any)")
QUICK = ("intent:wall(any, like=both, top) & near(nearest=circle, to=blue) & untouched(others)", "Demo", 2)
"""A shipped demonstration that the expert makes in half a second."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two demonstrations of each intent, in two scenes."""
    folder = tmp_path_factory.mktemp("made")
    dataset(TEXTS, 2, scenes=2, folder=folder, jobs=1)
    return folder


def test_a_data_set_holds_the_intent_and_what_a_policy_sees_of_each_demonstration(made: Path) -> None:
    content = (made / FILE).read_bytes()
    data = dataset(TEXTS, 2, scenes=2, folder=made)
    assert [example.intent for example in data] == [parse(text) for text in TEXTS for _ in range(2)]
    for number, example in enumerate(data):
        demo = example.demonstration
        assert demo.score == 1.0
        assert example.intent.holds(demo.scenes()[0], demo.scenes()[-1])
        assert demo.scene == task_spec(demo.task).demos[number % 2]
        np.testing.assert_array_equal(
            example.observations, np.asarray(magical_mj.demos.observations(demo, "State"))[:-1]
        )
        np.testing.assert_array_equal(example.actions, demo.actions)
    assert [len(part) for part in (data, data[1:], data[-1:])] == [4, 3, 1]
    assert data[1:][0].demonstration.digest == data[1].demonstration.digest
    assert (made / FILE).read_bytes() == content


def test_a_killed_command_continues_and_makes_the_same(made: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "magical_mj", "demos", "intents", ",".join(TEXTS), "--per-intent", "2"]
    process = subprocess.Popen([*command, "--scenes", "2", "--folder", str(tmp_path), "--jobs", "1"])
    path = tmp_path / FILE
    while not (path.exists() and path.read_bytes().endswith(b"\n")):
        time.sleep(0.02)
        assert process.poll() is None
    process.send_signal(signal.SIGKILL)
    process.wait()
    done = len(path.read_bytes().splitlines())
    assert done < 4
    with path.open("ab") as file:
        file.write(b'{"task":"intent:robot')  # killed in the middle of a line
    seen: list[tuple[int, int]] = []
    dataset(TEXTS, 2, scenes=2, folder=tmp_path, jobs=2, watch=lambda *numbers: seen.append(numbers))
    assert seen[0] == (done, 4)
    assert seen[-1] == (4, 4)
    assert sorted(path.read_bytes().splitlines()) == sorted((made / FILE).read_bytes().splitlines())


def test_demonstrations_of_test_sets_come_with_the_package(tmp_path: Path) -> None:
    shipped = stored.shipped()
    assert list(shipped) == [one.key for one in wanted()]
    assert all(one.scene == sample_scene(*key).digest() for key, one in shipped.items())
    keys = list(shipped)[::600]
    path = tmp_path / FILE
    for made in stored.complete(keys, path, known=shipped, jobs=1):
        demo = made.verified(path)
        assert demo.score == 1.0
        assert demo.scene in task_spec(demo.task).demos
    assert not path.exists()
    (fresh,) = stored.complete([QUICK], path)
    assert fresh == shipped[QUICK]


def test_a_larger_data_set_adds_to_the_file(made: Path, tmp_path: Path) -> None:
    path = tmp_path / FILE
    path.write_bytes((made / FILE).read_bytes())
    more = dataset(TEXTS[0], 3, scenes=2, folder=tmp_path)
    assert path.read_bytes().startswith((made / FILE).read_bytes())
    assert len(path.read_bytes().splitlines()) == 5
    assert len({example.demonstration.digest for example in more}) == 3


def test_wrong_arguments_of_a_data_set_are_refused(made: Path, tmp_path: Path) -> None:
    for wrong, error in (
        ({"intents": "robot at(home)"}, IntentError),
        ({"scenes": 9}, IntentError),
        ({"preset": "Stat"}, UnknownNameError),
        ({"variants": "Demos"}, UnknownNameError),
        ({"per_intent": 0}, SettingsError),
        ({"intents": ""}, SettingsError),
    ):
        with pytest.raises(error):
            dataset(**{"intents": TEXTS[0], "folder": tmp_path, **wrong})
    assert [*tmp_path.iterdir()] == []
    lines = (made / FILE).read_text().splitlines()
    (tmp_path / FILE).write_text("\n".join([*lines[:3], "{}", *lines[3:]]) + "\n")
    with pytest.raises(DemonstrationError, match=r"demonstrations.jsonl, line 4: .*delete this line"):
        dataset(TEXTS, 2, scenes=2, folder=tmp_path)


@pytest.mark.parametrize("change", [{"scene": "0" * 16}, {"actions": "aaa"}])
def test_demonstrations_of_another_version_are_refused(made: Path, tmp_path: Path, change: dict[str, str]) -> None:
    first = json.loads((made / FILE).read_text().splitlines()[0])
    (tmp_path / FILE).write_text(json.dumps({**first, **change}) + "\n")
    data = dataset(TEXTS[0], 1, scenes=2, folder=tmp_path)
    with pytest.raises(DemonstrationError, match="from another version of this package: delete the file"):
        data[0]


def test_failed_demonstrations_are_named_and_all_others_stored(made: Path, tmp_path: Path) -> None:
    (tmp_path / FILE).write_bytes((made / FILE).read_bytes())
    keys = [("intent:robot in()", "Demo", 0), ("intent:robot in()", "Nowhere", 0)]
    with pytest.raises(DemonstrationError, match=r"1 of 2 demonstrations could not be made: unknown variant 'Nowhere'"):
        stored.complete(keys, tmp_path / FILE, jobs=1)
    assert keys[0] in stored.read(tmp_path / FILE)
    assert keys[1] not in stored.read(tmp_path / FILE)


def test_one_command_writes_a_data_set_for_learners(made: Path, tmp_path: Path, shell: Shell) -> None:
    command = ("demos", "intents", ",".join(TEXTS), "--per-intent", 2, "--scenes", 2, "--folder", made)
    code, out, _ = shell(*command, "--to", "npz", "--out", tmp_path / "x.npz")
    assert code == 0
    assert "4 demonstrations of 2 intents" in out
    with np.load(tmp_path / "x.npz") as arrays:
        assert arrays["observations"].shape == (len(arrays["actions"]), 185)
        assert list(dict.fromkeys(arrays["tasks"])) == [f"intent:{text} [demos=2]" for text in TEXTS]
        assert arrays["sentences"].tolist() == [parse(text).sentence for text in TEXTS for _ in range(2)]
    assert "exists already" in shell.fails(1, *command, "--to", "npz", "--out", tmp_path / "x.npz")
    assert shell(*command, "--to", "webdataset", "--out", tmp_path / "web")[0] == 0
    with tarfile.open(next((tmp_path / "web").glob("*.tar.gz"))) as archive:
        metadata = json.loads(archive.extractfile("_metadata.json").read())  # pyright: ignore[reportOptionalMemberAccess]
    assert metadata["sentences"] == [task_spec(f"intent:{text}").instruction for text in TEXTS for _ in range(2)]
    assert "2 intents: 4 episodes" in (tmp_path / "web" / "README.md").read_text()
