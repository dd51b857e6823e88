"""Demonstrations for other tools: numpy archives and Minari data sets."""

from __future__ import annotations

import resource
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from subprocess import PIPE
from typing import Any

import numpy as np
import pytest

import magical_mj
from magical_mj import demos
from magical_mj.cli import main
from magical_mj.demos import Demonstration
from magical_mj.tasks.protocol import PROTOCOL
from magical_mj.utils.errors import DemonstrationError


@pytest.fixture(scope="module")
def demo() -> Demonstration:
    """A short one."""
    return demos.demonstrate("FixColour", "Demo", 0)


def test_npz_export(demo: Demonstration, tmp_path: Path) -> None:
    path = tmp_path / "out.npz"
    other = demos.demonstrate("MoveToRegion", "Jitter", 5)
    demos.to_npz([demo, other], path, "State", drop_noop=False)
    with np.load(path, allow_pickle=False) as archive:
        assert archive["observations"].shape == (100, len(magical_mj.scene.state_vector.STATE_NAMES))
        assert archive["episodes"].tolist() == [0] * 60 + [1] * 40
        assert archive["steps"].tolist() == [*range(60), *range(40)]
        assert np.array_equal(archive["actions"][:60], demo.actions)
        assert archive["tasks"].tolist() == ["FixColour", "MoveToRegion"]
        assert archive["variants"].tolist() == ["Demo", "Jitter"]
        assert archive["seeds"].tolist() == [0, 5]
        assert archive["lengths"].tolist() == [60, 40]
        assert archive["scores"].tolist() == [1.0, other.score]
    before = path.read_bytes()
    with pytest.raises(FileExistsError):
        demos.to_npz([demo], path)
    assert path.read_bytes() == before
    demos.to_npz([demo], path, "", overwrite=True)
    with np.load(path, allow_pickle=False) as archive:
        busy = np.flatnonzero(demo.actions)
        assert np.array_equal(archive["steps"], busy)
        assert archive["observations_ego"].shape == archive["observations_allo"].shape == (len(busy), 384, 384, 3)


@pytest.mark.parametrize("seed", [2**63, 2**64])
def test_seeds_that_do_not_fit_the_format_are_refused(
    demo: Demonstration, seed: int, tmp_path: Path, minari: Any
) -> None:
    """NumPy makes one floating-point column of them and smaller ones."""
    large = replace(demo, scene_seed=seed)
    with pytest.raises(DemonstrationError, match=f"seed {seed} does not fit the 64-bit integers"):
        demos.to_npz([demo, large], tmp_path / "out.npz", "State")
    with pytest.raises(DemonstrationError, match=f"seed {seed} does not fit the 64-bit integers"):
        demos.to_minari([demo, large])
    assert not (tmp_path / "out.npz").exists()
    assert minari.list_local_datasets() == {}


@pytest.fixture
def minari(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "sets"))
    return pytest.importorskip("minari")


def test_minari_export_is_lossless_and_its_environment_replays(demo: Demonstration, minari: Any) -> None:
    name = demos.to_minari([demo, demo], preset="LoRes4A")
    assert name == f"magical-mj/FixColour/Demo-expert-LoRes4A-p{PROTOCOL}-v0"
    dataset = minari.load_dataset(name)
    episode = dataset[0]
    assert np.array_equal(episode.observations, demos.observations(demo, "LoRes4A"))
    assert np.array_equal(episode.infos["qpos"], demo.qpos)
    assert np.array_equal(episode.infos["qvel"], demo.qvel)
    assert np.array_equal(episode.actions, demo.actions)
    assert episode.rewards.tolist() == [0.0] * 59 + [1.0]
    assert episode.truncations.tolist() == [False] * 59 + [True]
    for evaluation in (False, True):
        env = dataset.recover_environment(eval_env=evaluation)
        env.reset(seed=next(iter(dataset.storage.get_episode_metadata([0])))["seed"])
        seen, rewards, info = None, [], {}
        for action in episode.actions:
            seen, reward, _, _, info = env.step(action)
            rewards.append(reward)
        assert np.array_equal(seen, episode.observations[-1])
        assert info["eval_score"] == 1.0
        assert rewards == episode.rewards.tolist()
        env.close()


def test_minari_sets_name_everybody_who_made_them(demo: Demonstration, minari: Any) -> None:
    played = replace(demo, demonstrator="human", package="0.0.9")
    name = demos.to_minari([demo, played])
    assert name == f"magical-mj/FixColour/Demo-expert-human-State-p{PROTOCOL}-v0"
    metadata = minari.load_dataset(name).storage.metadata
    assert metadata["description"] == "2 demonstrations of FixColour-Demo by the expert and human of magical_mj"
    assert not metadata.get("requirements"), "of two versions, neither is required"


def test_all_ids_are_checked_before_the_first_minari_set_is_made(
    demo: Demonstration, minari: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = demos.demonstrate("MoveToRegion", "Jitter", 5)
    for one in (demo, other):
        demos.write(one, tmp_path / f"{one.name}.npz")
    there = demos.to_minari([other])  # the second one
    assert main(["demos", "export", str(tmp_path), "--to", "minari"]) == 2
    assert "there is a data set" in " ".join(capsys.readouterr().err.split())
    assert list(minari.list_local_datasets()) == [there]
    assert main(["demos", "export", str(tmp_path), "--to", "minari", "--force"]) == 0
    assert len(minari.list_local_datasets()) == 2


def test_minari_sets_of_other_presets_and_variants_stand_side_by_side(demo: Demonstration, minari: Any) -> None:
    other = demos.demonstrate("FixColour", "All", 0)
    made = {demos.to_minari([some], preset=preset) for some in (demo, other) for preset in ("State", "")}
    assert made == set(minari.list_local_datasets())
    assert len(made) == 4
    with pytest.raises(DemonstrationError, match="already"):
        demos.to_minari([demo])
    (name,) = (name for name in made if "Demo-expert-State" in name)
    assert minari.load_dataset(name).total_episodes == 1
    assert demos.to_minari([demo, demo], overwrite=True) == name
    assert minari.load_dataset(name).total_episodes == 2
    with pytest.raises(DemonstrationError, match="one environment"):
        demos.to_minari([demo, other])


@pytest.mark.parametrize("name", ["", "../x-v0", "/etc/x-v0", "a b-v0", "x-v", "a//b-v0"])
def test_bad_minari_ids_leave_nothing(demo: Demonstration, minari: Any, name: str, tmp_path: Path) -> None:
    with pytest.raises(DemonstrationError, match="id"):
        demos.to_minari([demo], name)
    assert [path for path in tmp_path.rglob("*") if path.name != "sets"] == []


def test_a_full_disk_leaves_what_was_there(demo: Demonstration, minari: Any, tmp_path: Path) -> None:
    name = demos.to_minari([demo])
    demos.to_npz([demo], tmp_path / "a.npz", "State")
    before = set(tmp_path.rglob("*"))
    with files_of_at_most(10_000):
        for other, overwrite in ((None, True), ("somebody/else/set-v0", False)):
            with pytest.raises(OSError, match="sets"):
                demos.to_minari([demo], other, overwrite=overwrite)
        for path, overwrite in ((tmp_path / "a.npz", True), (tmp_path / "b.npz", False)):
            with pytest.raises(OSError, match=path.name):
                demos.to_npz([demo], path, "LoRes4E", overwrite=overwrite)
        with pytest.raises(OSError, match=r"demo\.npz"):
            demos.write(demo, tmp_path / "demo.npz")
    assert before == set(tmp_path.rglob("*"))
    assert minari.load_dataset(name).total_episodes == 1
    with np.load(tmp_path / "a.npz") as archive:
        assert archive["seeds"].tolist() == [0]


def test_a_disk_with_room_for_the_arrays_alone_leaves_what_was_there(
    demo: Demonstration, minari: Any, tmp_path: Path
) -> None:
    """HDF5 would end the process."""
    ten = [demo] * 10
    name = demos.to_minari(ten)
    (written,) = (tmp_path / "sets" / name).rglob("*.hdf5")
    arrays = sum(10 * part.nbytes for part in (demo.qpos, demo.qvel, demos.observations(demo, "State")))
    assert arrays < written.stat().st_size
    with files_of_at_most((arrays + written.stat().st_size) // 2), pytest.raises(OSError, match="sets"):
        demos.to_minari(ten, overwrite=True)
    assert minari.load_dataset(name).total_episodes == 10


def test_exports_at_the_same_time_take_turns(demo: Demonstration, minari: Any) -> None:
    program = (
        "import sys, time, minari; from magical_mj import demos\n"
        "make = minari.create_dataset_from_buffers\n"
        "def slowly(**given):\n"
        "    made = make(**given); print('here', flush=True); sys.stdin.readline(); return made\n"
        "minari.create_dataset_from_buffers = slowly\n"
        "demos.to_minari(demos.load('FixColour')[:3], 'both-v0')\n"
    )
    first = subprocess.Popen([sys.executable, "-c", program], stdin=PIPE, stdout=PIPE, text=True)
    assert first.stdout is not None
    assert first.stdout.readline() == "here\n"
    program = (
        "from magical_mj import demos; some = demos.load('FixColour')[:1]; import minari\n"
        "print('here', flush=True); demos.to_minari(some, 'both-v0')\n"
    )
    second = subprocess.Popen([sys.executable, "-c", program], stdout=PIPE, stderr=PIPE, text=True)
    assert second.stdout is not None
    assert second.stdout.readline() == "here\n"
    with pytest.raises(subprocess.TimeoutExpired):
        second.wait(1)  # it waits, instead of taking what is there for the rest of a dead process
    first.communicate("go on\n")
    assert "there is a data set" in second.communicate()[1]
    assert (first.returncode, second.returncode) == (0, 1)
    assert minari.load_dataset("both-v0").total_episodes == 3


def test_a_process_that_died_while_it_made_a_new_set_leaves_room_for_another(demo: Demonstration, minari: Any) -> None:
    program = (
        "import os, minari; from magical_mj import demos\n"
        "make = minari.create_dataset_from_buffers\n"
        "minari.create_dataset_from_buffers = lambda **given: (make(**given), os.kill(os.getpid(), 9))\n"
        "demos.to_minari(demos.load('FixColour')[:2], 'new-v0')\n"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == -9
    demos.to_minari([demo], "new-v0")
    assert minari.load_dataset("new-v0").total_episodes == 1


@pytest.mark.parametrize("overwrite", [True, False])
def test_a_process_that_died_while_it_replaced_a_set_costs_nothing(
    demo: Demonstration, minari: Any, overwrite: bool
) -> None:
    name = demos.to_minari([demo])
    program = (
        "import os, sys, minari; from magical_mj import demos\n"
        "minari.create_dataset_from_buffers = lambda **_: os.kill(os.getpid(), 9)\n"
        "demos.to_minari(demos.load('FixColour')[:1], sys.argv[1], overwrite=True)\n"
    )
    assert subprocess.run([sys.executable, "-c", program, name], check=False).returncode == -9
    assert name not in minari.list_local_datasets()
    if overwrite:
        demos.to_minari([demo, demo], overwrite=True)
    else:
        with pytest.raises(DemonstrationError, match="already"):
            demos.to_minari([demo])
    assert minari.load_dataset(name).total_episodes == 1 + overwrite


def test_a_process_that_died_while_it_removed_the_replaced_set_leaves_the_new_one(
    demo: Demonstration, minari: Any, tmp_path: Path
) -> None:
    name = demos.to_minari([demo])
    program = (
        "import os, shutil, sys; from magical_mj import demos\n"
        "shutil.rmtree = lambda folder, **_: os.path.exists(folder) and os.kill(os.getpid(), 9)\n"
        "some = demos.load('FixColour')[:1]\n"
        "demos.to_minari([*some, *some], sys.argv[1], overwrite=True)\n"
    )
    assert subprocess.run([sys.executable, "-c", program, name], check=False).returncode == -9
    with pytest.raises(DemonstrationError, match="already"):
        demos.to_minari([demo])
    assert minari.load_dataset(name).total_episodes == 2
    assert list((tmp_path / "sets" / name).parent.glob(".*")) == []


def test_an_export_that_fails_leaves_what_others_made_beside_it(
    demo: Demonstration, minari: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Both start in a namespace that does not exist yet; the other one ends first."""
    write = minari.create_dataset_from_buffers

    def interrupted(**arguments: Any) -> None:
        monkeypatch.setattr(minari, "create_dataset_from_buffers", write)
        demos.to_minari([demo], "new/theirs/set-v0")
        write(**arguments)
        raise KeyboardInterrupt

    monkeypatch.setattr(minari, "create_dataset_from_buffers", interrupted)
    with pytest.raises(KeyboardInterrupt):
        demos.to_minari([demo], "new/mine/set-v0")
    assert list(minari.list_local_datasets()) == ["new/theirs/set-v0"]
    assert not (tmp_path / "sets" / "new" / "mine").exists()


@contextmanager
def files_of_at_most(size: int) -> Iterator[None]:
    """As if the disk were full: whoever writes more bytes into a file gets an error."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
