"""Demonstrations as robomimic's HDF5: what the file holds, and what robomimic's own reader makes of it."""

from __future__ import annotations

import json
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from magical_mj import demos
from magical_mj.demos.export.robomimic import to_robomimic
from magical_mj.scene.actions import to_vector
from magical_mj.utils.errors import DemonstrationError, UnknownNameError

h5py = pytest.importorskip("h5py")


@pytest.fixture(scope="module")
def two() -> list[demos.Demonstration]:
    return demos.load("FixColour")[:2]


def test_the_file_replays_to_the_full_score(two: list[demos.Demonstration], tmp_path: Path) -> None:
    to_robomimic(two, tmp_path / "set.hdf5", views="state")
    with h5py.File(tmp_path / "set.hdf5") as file:
        assert list(file["data"]) == ["demo_0", "demo_1"]
        assert file["data"].attrs["total"] == 120
        told = json.loads(file["data"].attrs["env_args"])
        env = gymnasium.make(told["env_name"], **told["env_kwargs"])
        for demo, group in zip(two, file["data"].values(), strict=True):
            assert group.attrs["num_samples"] == len(demo.actions)
            env.reset(options={"scene": demo.scene})
            rewards = [float(env.step(action)[1]) for action in group["actions"][()]]
            assert rewards == group["rewards"][()].tolist()
            assert rewards[-1] == 1.0
            np.testing.assert_array_equal(group["obs/state"][1:], group["next_obs/state"][:-1])
            np.testing.assert_array_equal(group["states"], np.concatenate([demo.qpos, demo.qvel], axis=1)[:-1])
        env.close()


def test_pictures_are_those_of_the_episode(two: list[demos.Demonstration], tmp_path: Path) -> None:
    to_robomimic(two[:1], tmp_path / "set.hdf5", views="both")
    with h5py.File(tmp_path / "set.hdf5") as file:
        group = file["data/demo_0"]
        wanted = demos.observations(two[0], "LoResFingers")
        for view in ("ego", "allo"):
            np.testing.assert_array_equal(group[f"obs/{view}_image"], wanted[view][:-1])
            np.testing.assert_array_equal(group[f"next_obs/{view}_image"], wanted[view][1:])
        assert group["dones"][()].tolist() == [0] * 59 + [1]


def test_nothing_is_overwritten_or_half_written(two: list[demos.Demonstration], tmp_path: Path) -> None:
    (tmp_path / "set.hdf5").write_text("mine")
    with pytest.raises(FileExistsError):
        to_robomimic(two, tmp_path / "set.hdf5", views="state")
    with pytest.raises(DemonstrationError, match="one environment"):
        to_robomimic([*two, *demos.load("FindDupe")[:1]], tmp_path / "other.hdf5")
    with pytest.raises(UnknownNameError, match="both"):
        to_robomimic(two, tmp_path / "other.hdf5", views="bot")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"set.hdf5": b"mine"}


def test_robomimic_reads_it(two: list[demos.Demonstration], tmp_path: Path) -> None:
    pytest.importorskip("robomimic")
    from robomimic.utils import obs_utils
    from robomimic.utils.dataset import SequenceDataset

    to_robomimic(two, tmp_path / "set.hdf5")
    obs_utils.initialize_obs_utils_with_obs_specs({"obs": {"rgb": ["ego_image"]}})
    read = SequenceDataset(
        str(tmp_path / "set.hdf5"), ("ego_image",), ("actions", "rewards", "dones"), frame_stack=4, seq_length=8
    )
    assert len(read) == 120
    item = read[61]  # the second step of the second demonstration
    assert item["obs"]["ego_image"].shape == (11, 96, 96, 3)
    wanted = demos.observations(two[1], "LoResFingers")["ego"]
    np.testing.assert_array_equal(item["obs"]["ego_image"][3], wanted[1])
    np.testing.assert_array_equal(item["actions"][3:], to_vector(two[1].actions[1:9]))
