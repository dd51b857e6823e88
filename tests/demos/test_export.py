"""Demonstrations for other tools: numpy archives, Minari data sets, and robomimic's HDF5."""

from __future__ import annotations

import io
import json
import sys
import tarfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from PIL import Image

import magical_mj
from magical_mj import demos
from magical_mj.cli import main
from magical_mj.demos import Demonstration
from magical_mj.exports import folders
from magical_mj.exports.robomimic import to_robomimic
from magical_mj.protocol import PROTOCOL
from magical_mj.utils.errors import DemonstrationError, SettingsError, UnknownNameError
from tests.helpers.commands import example


@pytest.fixture(scope="module")
def demo() -> Demonstration:
    """A short one."""
    return demos.load("FixColour")[0]


def test_npz_export(demo: Demonstration, tmp_path: Path) -> None:
    path = tmp_path / "out.npz"
    other = demos.demonstrate("MoveToRegion", "Jitter", 5)
    demos.to_npz([demo, other], path, "State", drop_noop=False)
    with np.load(path, allow_pickle=False) as archive:
        assert archive["observations"].shape == (100, len(magical_mj.observations.STATE_NAMES))
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


def test_webdataset_export(demo: Demonstration, tmp_path: Path) -> None:
    """In the order in which a stream reads it, with a card that says what it is."""
    archive = folders.to_webdataset([demo, demo], tmp_path / "set", "State")
    assert archive.read_bytes()[4:8] == bytes(4)  # no time: it is the same whenever it is made
    with tarfile.open(archive, "r|gz") as stream:
        parts = {member.name: stream.extractfile(member).read() for member in stream}  # pyright: ignore[reportOptionalMemberAccess]
    metadata = json.loads(parts.pop("_metadata.json"))
    assert (metadata["environment"], metadata["protocol"], metadata["steps"]) == ("FixColour-Demo", PROTOCOL, 120)
    assert metadata["digests"] == [demo.digest] * 2
    arrays = {name: np.load(io.BytesIO(content), allow_pickle=False) for name, content in parts.items()}
    assert list(arrays)[:4] == [f"000-0000.{part}.npy" for part in ("obs", "next_obs", "acts", "dones")]
    assert len(arrays) == 4 * 120
    observations = demos.observations(demo, "State")
    assert np.array_equal(arrays["001-0030.obs.npy"], observations[30])
    assert np.array_equal(arrays["001-0030.next_obs.npy"], arrays["001-0031.obs.npy"])
    assert [arrays[f"000-{step:04}.acts.npy"].item() for step in range(60)] == demo.actions.tolist()
    assert [step for step in range(60) if arrays[f"000-{step:04}.dones.npy"]] == [59]
    card = (tmp_path / "set" / "README.md").read_text()
    assert card.startswith("---\nlicense: apache-2.0")
    assert "scores 1.00 to 1.00" in card
    with pytest.raises(FileExistsError):
        folders.to_webdataset([demo], tmp_path / "set")


def test_data_sets_in_one_call(tmp_path: Path, minari: Any) -> None:
    first = magical_mj.datasets.load("MoveToRegion", "npz", tmp_path, preset="State")
    assert magical_mj.datasets.load("MoveToRegion", "npz", tmp_path, preset="State").keys() == first.keys()
    assert len(first["actions"]) == np.count_nonzero(np.concatenate([d.actions for d in demos.load("MoveToRegion")]))
    again = [magical_mj.datasets.load("MoveToRegion", "minari") for _ in range(2)]
    assert [data.total_episodes for data in again] == [25, 25]
    assert magical_mj.datasets.load("MoveToRegion", "webdataset", tmp_path, preset="State").is_file()
    with pytest.raises(UnknownNameError, match="format of data sets"):
        magical_mj.datasets.load("MoveToRegion", "hdf5")  # pyright: ignore[reportArgumentType]


def test_own_recordings_are_not_taken_for_the_shipped_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, minari: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    for number in (0, 1):
        demos.keep(demos.demonstrate("MoveToRegion", "Demo", number), tmp_path / "mine")
    assert main(["demos", "export", "mine", "--tasks", "MoveToRegion", "--to", "minari"]) == 0
    assert main(["demos", "export", "mine", "--preset", "State", "--no-drop-noop"]) == 0
    assert magical_mj.datasets.load("MoveToRegion", "minari").total_episodes == 25
    data = magical_mj.datasets.load("MoveToRegion", "npz", ".", preset="State")
    assert len(data["seeds"]) == 25
    assert data["actions"].all()  # without no-ops
    assert len(minari.list_local_datasets()) == 2


def quarter(*_: Any) -> float:
    """Another score of a task."""
    return 0.25


def test_data_sets_of_tasks_of_ones_own_follow_their_demonstrations(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A folder to which a demonstration is added gives another data set. Training data are of the demo scene only."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.syspath_prepend(example("push_out"))
    (tmp_path / "pushed.py").write_text(
        "import pathlib, push_out\nfrom dataclasses import replace\n"
        "SPEC = replace(push_out.SPEC, name='Pushed', demonstrations=pathlib.Path(__file__).parent / 'own')\n"
    )
    kept = {"to": "npz", "folder": tmp_path / "sets", "preset": "State"}
    for number in (1, 2):
        demo = demos.recorded("pushed:SPEC", "Demo", number, [1] * 100 + [number] * 20, "human")
        demos.keep(demo, tmp_path / "own")
        data = magical_mj.datasets.load("pushed:SPEC", **kept)
        assert data["seeds"].tolist() == list(range(1, number + 1))
    demos.keep(demos.recorded("pushed:SPEC", "Layout", 3, [1] * 120, "human"), tmp_path / "own")
    name = magical_mj.env_id("pushed:SPEC", "Layout", "State")
    with pytest.raises(DemonstrationError, match="has 2 demonstrations, but this needs 5"):
        magical_mj.datasets.make_env_and_datasets(name)
    for number in (3, 4, 5):
        demos.keep(demos.recorded("pushed:SPEC", "Demo", number, [1] * 120, "human"), tmp_path / "own")
    env, *parts = magical_mj.datasets.make_env_and_datasets(name)
    assert [part["truncations"].sum() for part in parts] == [4, 1]
    env.close()
    assert {demo.score for demo in demos.load("pushed:SPEC")} == {0.0}
    pushed = sys.modules["pushed"]
    monkeypatch.setattr(pushed, "SPEC", replace(pushed.SPEC, score=quarter))
    with pytest.warns(UserWarning, match="the score of pushed:SPEC has changed: its demonstrations are scored anew"):
        assert {demo.score for demo in demos.load("pushed:SPEC")} == {0.25}


def test_an_environment_with_data_for_training_and_validation() -> None:
    env, training, validation = magical_mj.datasets.make_env_and_datasets("magical_mj/MoveToRegion-TestAll-State-v0")
    assert (training["truncations"].sum(), validation["truncations"].sum()) == (20, 5)
    assert not training["terminals"].any()  # as in the environment and in Minari
    assert env.observation_space.contains(training["next_observations"][0])
    assert len(training["observations"]) == len(training["actions"]) == len(training["terminals"])
    for options in ({"action": "continuous"}, {"image_size": 48}):
        with pytest.raises(SettingsError, match=r"of this environment are .*: leave out the options that change them"):
            magical_mj.datasets.make_env_and_datasets("magical_mj/MoveToRegion-Demo-LoRes4E-v0", **options)
    with pytest.raises(SettingsError, match="CartPole-v1 is not the id of a task's environment"):
        magical_mj.datasets.make_env_and_datasets("CartPole-v1")
    for options in ({"body": "shortstick"}, {"shifts": "body:shortstick"}):
        with pytest.raises(DemonstrationError, match="of MoveToRegion with the body 'shortstick'"):
            magical_mj.datasets.make_env_and_datasets("magical_mj/MoveToRegion-Demo-State-v0", **options)
    with pytest.raises(SettingsError, match="not one array"):
        magical_mj.datasets.make_env_and_datasets("magical_mj/MoveToRegion-Demo-v0")
    with pytest.raises(SettingsError, match="without shifts: leave out shifts"):
        magical_mj.datasets.make_env_and_datasets("magical_mj/MoveToRegion-Demo-LoRes4E-v0", shifts="camera:3")


def test_pictures_of_an_environment_and_its_data_are_by_one_renderer() -> None:
    name = "magical_mj/MoveToRegion-Demo-LoRes4E-v0"
    env, _, validation = magical_mj.datasets.make_env_and_datasets(name, renderer="software")
    first, seed = validation["observations"][0], demos.load("MoveToRegion")[4].seed
    np.testing.assert_array_equal(env.reset(seed=seed)[0], first)
    env.close()


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


def test_the_command_says_how_to_load_a_minari_data_set(
    tmp_path: Path, minari: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["demos", "export", "--tasks", "MoveToRegion", "--to", "minari"]) == 0
    name, where = capsys.readouterr().out.splitlines()
    assert where == f"in {tmp_path / 'sets' / name}; to load it: minari.load_dataset({name!r})"
    assert minari.load_dataset(name).total_episodes == 25


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
    for episode in (demo, other):
        demos.write(episode, tmp_path / f"{episode.name}.npz")
    assert main(["demos", "export", str(tmp_path / f"{other.name}.npz"), "--to", "minari"]) == 0  # the second one
    (there,) = minari.list_local_datasets()
    assert main(["demos", "export", str(tmp_path), "--to", "minari"]) == 1
    assert "the data set" in " ".join(capsys.readouterr().err.split())
    assert list(minari.list_local_datasets()) == [there]
    assert main(["demos", "export", str(tmp_path), "--to", "minari", "--force"]) == 0
    assert len(minari.list_local_datasets()) == 2


def test_minari_sets_of_other_presets_and_variants_stand_side_by_side(demo: Demonstration, minari: Any) -> None:
    other = demos.demonstrate("FixColour", "All", 0)
    names = {demos.to_minari([episode], preset=preset) for episode in (demo, other) for preset in ("State", "LoRes4A")}
    assert names == set(minari.list_local_datasets())
    assert len(names) == 4
    with pytest.raises(FileExistsError):
        demos.to_minari([demo])
    (name,) = (name for name in names if "Demo-expert-State" in name)
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


@pytest.mark.parametrize(("preset", "settings"), [("LoRes4E", {"jpeg_encoding": False}), ("LoResCHW4E", {})])
def test_minaris_collector_stores_the_exact_pictures(
    preset: str, settings: dict[str, Any], minari: Any, tmp_path: Path
) -> None:
    """Exactly, in a stack of frames, as docs/integrations.md says; by the collector's storage, since it needs jax."""
    from minari.data_collector import EpisodeBuffer
    from minari.dataset.minari_storage import MinariStorage

    env = gymnasium.make(magical_mj.env_id("MoveToRegion", "Demo", preset), renderer="software")
    spaces = (env.observation_space, env.action_space)
    seen = [env.reset(seed=0)[0], *(env.step(action)[0] for action in (1, 2))]
    storage = MinariStorage.new(tmp_path / "data", *spaces, env.spec, **settings)
    flags: list[Any] = [False, False]
    storage.update_episodes([EpisodeBuffer(0, 0, None, seen, [1, 2], [0.0, 0.0], flags, [False, True], {})])
    (episode,) = storage.get_episodes([0])
    assert np.array_equal(episode["observations"], seen)
    env.close()


@pytest.mark.parametrize("given", [None, "FixColour", [3]])
def test_exports_of_other_objects_are_refused(given: Any, demo: Demonstration, tmp_path: Path) -> None:
    for one in (given, demo):
        for call in (demos.to_npz, to_robomimic):
            with pytest.raises(DemonstrationError, match=r"give demonstrations in a list|is not a demonstration"):
                call(one, tmp_path / "set")
    if given != "FixColour":  # a task
        with pytest.raises(DemonstrationError, match=r"give demonstrations in a list|is not a demonstration"):
            demos.transitions(given)


@pytest.fixture(scope="module")
def two() -> list[demos.Demonstration]:
    return demos.load("FixColour")[:2]


def test_the_file_replays_to_the_full_score(two: list[demos.Demonstration], tmp_path: Path) -> None:
    to_robomimic(two, tmp_path / "set.hdf5", views="state")
    h5py = pytest.importorskip("h5py")
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
    h5py = pytest.importorskip("h5py")
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


SOURCES: list[Any] = [
    ("FixColour", "Demo", {}),
    ("MoveToRegion", "Jitter", {"shifts": "clutter:2,slip:3"}),
    ("MoveToRegion", "Layout", {"body": "shortstick"}),
]


@pytest.mark.parametrize(("task", "variant", "how"), SOURCES, ids=["plain", "shifted", "stick"])
def test_the_environment_that_a_data_set_names_observes_what_it_holds(
    task: str, variant: str, how: dict[str, str], tmp_path: Path, minari: Any
) -> None:
    """In every format: its first and its last observation are those of the file, and so is the score."""
    h5py = pytest.importorskip("h5py")
    demo = demos.demonstrate(task, variant, 5, **how)

    def check(env: gymnasium.Env[Any, Any], seen: Any, seed: int, *, actions: Any = demo.actions) -> None:
        """`seen` gives what the file holds before each action."""
        observation, info = env.reset(seed=seed)
        for step, action in enumerate(actions):
            if step in (0, len(actions) - 1):
                for name, wanted in seen(step).items():
                    assert np.array_equal(observation[name] if name else observation, wanted), (step, name)
            observation, *_, info = env.step(action)
        assert info["eval_score"] == demo.score
        env.close()

    for views, preset in (("both", ""), ("ego", ""), ("state", "State")):
        to_robomimic([demo], tmp_path / f"{views}.hdf5", views=views)
        with h5py.File(tmp_path / f"{views}.hdf5") as file:
            about, group = json.loads(file["data"].attrs["env_args"]), file["data/demo_0"]
            names = {"": "state"} if preset else {key.removesuffix("_image"): key for key in group["obs"]}
            made, seed = gymnasium.make(about["env_name"], **about["env_kwargs"]), int(group.attrs["seed"])
            check(made, lambda step, g=group, n=names: {k: g["obs"][v][step] for k, v in n.items()}, seed,
                  actions=group["actions"][()])  # fmt: skip
    data = minari.load_dataset(demos.to_minari([demo], preset="LoResFingers"))
    seed = next(iter(data.storage.get_episode_metadata([0])))["seed"]
    for made in (data.recover_environment(), data.recover_environment(eval_env=True)):
        check(made, lambda step: {name: rows[step] for name, rows in data[0].observations.items()}, seed)
    demos.to_npz([demo], tmp_path / "set.npz", "State", drop_noop=False)
    with np.load(tmp_path / "set.npz", allow_pickle=False) as file:
        task, variant, body, shifts, seed = (file[f][0] for f in ("tasks", "variants", "bodies", "shifts", "seeds"))
        name = magical_mj.env_id(str(task), str(variant), "State")
        made = gymnasium.make(name, body=str(body), shifts=str(shifts))
        check(made, lambda step, rows=file["observations"]: {"": rows[step]}, int(seed))
    archive = folders.to_webdataset([demo], tmp_path / "set", "LoRes4A")
    with tarfile.open(archive) as stream:
        parts = {member.name: stream.extractfile(member).read() for member in stream}  # pyright: ignore[reportOptionalMemberAccess]
    about = json.loads(parts["_metadata.json"])
    made = gymnasium.make(about["gymnasium"]["id"], **about["gymnasium"]["kwargs"])
    check(made, lambda step: {"": np.load(io.BytesIO(parts[f"000-{step:04}.obs.npy"]))}, about["scene_seeds"][0])
    assert f'`gymnasium.make("{about["gymnasium"]["id"]}"' in (tmp_path / "set" / "README.md").read_text()
    folders.to_xirl([demo, demo], tmp_path / "xirl")
    folder = tmp_path / "xirl" / "valid" / demo.scene.robot.body / "0"
    made = gymnasium.make(magical_mj.env_id(demo.task, demo.variant), **how, renderer="software")
    check(made, lambda step: {"allo": np.asarray(Image.open(folder / f"{step}.png"))}, demo.scene_seed)
