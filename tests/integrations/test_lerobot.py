"""The LeRobot plug-in, by lerobot itself: `make integrations-test LIBRARY=lerobot` runs this."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import magical_mj
from magical_mj.actions import to_vector
from magical_mj.exports.folders import to_webdataset
from magical_mj.exports.lerobot import to_lerobot
from magical_mj.shifts import SHIFTS
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import DemonstrationError, InvalidSceneError, MagicalError, SettingsError, UnknownNameError
from tests.shifts import test_received as received

ROOT = Path(__file__).parents[2]
MISSING = "lerobot is missing: make integrations-test LIBRARY=lerobot"
needs_lerobot = pytest.mark.skipif(find_spec("lerobot") is None, reason=MISSING)
pytestmark = pytest.mark.filterwarnings("default")  # lerobot's own are not ours to mend


@pytest.mark.skipif(find_spec("lerobot") is not None, reason="lerobot is installed")
def test_without_lerobot_one_line_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(MagicalError, match=r'pip install .*\[eval\]" "lerobot\[dataset\]==.*`make lerobot`'):
        import_module("magical_mj.integrations.lerobot")
    with pytest.raises(MagicalError, match="make lerobot"):
        to_lerobot(magical_mj.demos.load("FixColour")[:1], tmp_path / "set")
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
@pytest.mark.parametrize("python", ["false", "python-that-is-not-there"])
def test_make_says_which_python_lerobot_needs(python: str) -> None:
    command = ["make", "--file", str(ROOT / "Makefile"), "lerobot", f"INTEGRATION_PYTHON={python}"]
    made = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert made.returncode != 0
    assert "lerobot: it needs Python 3.12 or 3.13: give INTEGRATION_PYTHON=" in made.stderr


@pytest.fixture(scope="module")
def plugin() -> Any:
    return import_module("magical_mj.integrations.lerobot")


@needs_lerobot
@pytest.mark.parametrize("task", magical_mj.TASKS)
def test_a_data_set_read_back_replays_to_the_full_score(
    task: str, plugin: Any, tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    demos = magical_mj.demos.load(task)
    made = to_lerobot(demos, tmp_path / "set")
    read = LeRobotDataset(made.repo_id, root=tmp_path / "set")
    assert (read.num_episodes, read.num_frames) == (len(demos), sum(len(demo.actions) for demo in demos))
    env = plugin.LeRobotEnv(task, "Demo")
    number = 0
    for demo in demos:
        observation, _ = env.reset(seed=0, options={"scene": demo.scene, "lerobot_new_rollout": True})
        for _ in demo.actions:
            row = read[number]
            picture = (row["observation.image"].numpy().transpose(1, 2, 0) * 255).round().astype(np.uint8)
            np.testing.assert_array_equal(picture, observation["pixels"])
            assert row["task"] == env.task_description
            observation, reward, _, truncated, info = env.step(row["action"].numpy())
            number += 1
        assert env.unwrapped.score() == 1.0
        assert reward == info["eval_score"] == (1.0 if truncated else 0.0)  # some end when they have reached their goal
    env.close()
    size = sum(path.stat().st_size for path in (tmp_path / "set").rglob("*") if path.is_file())
    record_property("compared", f"{len(demos)} demonstrations of {task}")
    record_property("result", f"1.00 from {size / 1e6:.1f} MB")


@needs_lerobot
def test_both_views_and_the_fingers(plugin: Any, tmp_path: Path) -> None:
    demo = magical_mj.demos.load("FixColour")[0]
    made = to_lerobot([demo], tmp_path / "set", views="both", fingers=True)
    env = plugin.LeRobotEnv("FixColour", "Demo", "both", fingers=True)
    observation, _ = env.reset(seed=0)
    row = made[0]
    np.testing.assert_allclose(row["observation.state"].numpy(), observation["agent_pos"], atol=1e-7)
    np.testing.assert_allclose(observation["agent_pos"], (np.pi / 8, -np.pi / 8), atol=1e-6)
    assert {f"observation.images.{view}" for view in observation["pixels"]} <= row.keys()
    env.close()


@needs_lerobot
def test_states_instead_of_pictures(plugin: Any, tmp_path: Path) -> None:
    demo = magical_mj.demos.load("FixColour")[0]
    made = to_lerobot([demo], tmp_path / "set", views="state")
    wanted = magical_mj.demos.observations(demo, "State")
    env = plugin.LeRobotEnv("FixColour", "Demo", "state")
    observation, _ = env.reset(options={"scene": demo.scene})
    assert set(observation) == {"environment_state", "agent_pos"}
    for number, action in enumerate(demo.actions[:5]):
        np.testing.assert_array_equal(made[number]["observation.environment_state"].numpy(), wanted[number])
        np.testing.assert_array_equal(observation["environment_state"], wanted[number])
        observation = env.step(magical_mj.actions.to_vector(action))[0]
    env.close()


@needs_lerobot
def test_nothing_is_overwritten(tmp_path: Path) -> None:
    demos = magical_mj.demos.load("FixColour")[:1]
    to_lerobot(demos, tmp_path / "set")
    with pytest.raises(FileExistsError):
        to_lerobot(demos, tmp_path / "set")
    with pytest.raises(DemonstrationError, match="one environment"):
        to_lerobot([*demos, *magical_mj.demos.load("FindDupe")[:1]], tmp_path / "other")
    with pytest.raises(UnknownNameError, match="both"):
        to_lerobot(demos, tmp_path / "other", views="bot")
    assert [path.name for path in tmp_path.iterdir()] == ["set"]


@needs_lerobot
@pytest.mark.parametrize("options", [{}, {"views": "both"}, {"views": "allo", "fingers": True}, {"views": "state"}])
@pytest.mark.filterwarnings("ignore")
def test_gymnasium_finds_nothing_wrong(plugin: Any, options: dict[str, Any]) -> None:
    env = plugin.LeRobotEnv("MoveToRegion", "Demo", **options)
    check_env(env, skip_render_check=True)
    env.close()


@needs_lerobot
@pytest.mark.parametrize("batch", [1, 3])
def test_seeds_of_the_evaluation_are_the_official_scenes(plugin: Any, batch: int) -> None:
    suites = plugin.MagicalConfig(task="MoveToCorner,FindDupe", variant="Shape,Demo").create_envs(batch)
    assert {task: len(suite) for task, suite in suites.items()} == {"FindDupe": 2, "MoveToCorner": 2}
    assert list(suites) == ["MoveToCorner", "FindDupe"]
    vector = suites["FindDupe"][0]
    vector.reset(seed=list(range(5, 5 + batch)))
    scenes = [env.unwrapped.scene for env in vector.envs]
    wanted = [magical_mj.sample_scene("FindDupe", "Shape", 5 + number) for number in range(batch)]
    for scene, other in zip(scenes, wanted, strict=True):
        np.testing.assert_allclose(scene.robot.pose, other.robot.pose, atol=1e-9)
        assert [(block.shape, block.colour) for block in scene.blocks] == [(b.shape, b.colour) for b in other.blocks]
    assert vector.call("_max_episode_steps") == (100,) * batch
    for suite in suites.values():
        for made in suite.values():
            made.close()


@needs_lerobot
def test_workers_of_their_own_give_the_same(plugin: Any) -> None:
    config = plugin.MagicalConfig(task="MoveToRegion", variant="Layout")
    seen = []
    for asynchronous in (False, True):
        envs = config.create_envs(2, asynchronous)["MoveToRegion"][0]
        assert isinstance(envs, gymnasium.vector.AsyncVectorEnv) == asynchronous
        observations, _ = envs.reset(seed=[0, 1])
        seen.append(observations["pixels"])
        envs.close()
    np.testing.assert_array_equal(*seen)


@needs_lerobot
@pytest.mark.parametrize("axis", SHIFTS)
def test_shifts_reach_lerobot(axis: str, plugin: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures, effects of actions, and the sentence, which lerobot reads at each step."""
    monkeypatch.setenv("MAGICAL_MJ_RENDERER", "software")
    config = plugin.MagicalConfig(task=received.TASK, views="both", shifts=f"{axis}:5")
    envs = config.create_envs(1)[received.TASK][0]
    (observation, _), pictures, sentences = envs.reset(seed=[received.SEED]), [], set()
    for action in received.ACTIONS:
        pictures.append(received.newest({view: rows[0] for view, rows in observation["pixels"].items()}))
        sentences |= set(envs.call("task_description"))
        observation, *_ = envs.step(to_vector(action)[None])
    envs.close()
    assert (pictures, sentences) == received.by_engine(f"{axis}:5")


@needs_lerobot
def test_bodies_in_lerobot(plugin: Any) -> None:
    env = plugin.LeRobotEnv("MoveToRegion", "Demo", body="shortstick")
    env.reset(seed=0)
    assert env.unwrapped.scene.robot.body == "shortstick"
    with pytest.raises(InvalidSceneError, match="unknown body 'snake'"):
        plugin.MagicalConfig(body="snake").create_envs(1)


@needs_lerobot
def test_the_control_has_the_same_scenes_without_the_shifts(plugin: Any) -> None:
    config = plugin.MagicalConfig(task="FixColour", variant="Demo,Layout", shifts="clutter:3,words:5", control=True)
    suites = config.create_envs(1)
    assert {suite: len(envs) for suite, envs in suites.items()} == {"FixColour": 2, "FixColour-unshifted": 2}
    seen = {}
    for suite, envs in suites.items():
        envs[1].reset(seed=[4])
        seen[suite] = envs[1].envs[0].unwrapped.initial_scene, envs[1].call("task_description")[0]
        for made in envs.values():
            made.close()
    assert seen["FixColour-unshifted"][0] == magical_mj.sample_scene("FixColour", "Layout", 4)
    assert seen["FixColour-unshifted"][1] == task_spec("FixColour").summary
    for control, shifted in zip(seen["FixColour-unshifted"], seen["FixColour"], strict=True):
        assert control != shifted
    with pytest.raises(SettingsError, match="a control is played without the shifts: give shifts"):
        plugin.MagicalConfig(control=True).create_envs(1)


@needs_lerobot
def test_intents_and_their_sentences_in_lerobot(plugin: Any, tmp_path: Path) -> None:
    intent = magical_mj.intents.parse("in(colour=red, region) & untouched(others)")
    task = f"intent:{intent}"
    ((suite, envs),) = plugin.MagicalConfig(task=task, variant="Layout").create_envs(1).items()
    observation, _ = envs[0].reset(seed=[2])
    sentence = intent.sentence
    assert (suite, envs[0].call("task_description")) == (task, (sentence,))
    made = to_lerobot([magical_mj.demos.demonstrate(task, "Layout", 2)], tmp_path / "set")
    assert made[0]["task"] == sentence
    picture = (made[0]["observation.image"].numpy().transpose(1, 2, 0) * 255).round().astype(np.uint8)
    np.testing.assert_array_equal(picture, observation["pixels"][0])
    envs[0].close()


@needs_lerobot
def test_the_card_of_a_data_set_has_the_options_of_its_environment(plugin: Any, tmp_path: Path) -> None:
    demo = magical_mj.demos.demonstrate("MoveToRegion", "Jitter", 5, shifts="clutter:2,slip:3")
    made = to_lerobot([demo], tmp_path / "set", views="both", fingers=True)
    line = next(line for line in (tmp_path / "set" / "README.md").read_text().splitlines() if "--env.type" in line)
    found = dict(re.findall(r"--env\.(\w+)=([^ `]+)", line))
    assert found.pop("type") == "magical"
    options = {**found, "fingers": found["fingers"] == "true"}
    envs = plugin.MagicalConfig(**options).create_envs(1)["MoveToRegion"][0]
    observation, _ = envs.reset(seed=[demo.scene_seed])
    for view, pictures in observation["pixels"].items():
        held = (made[0][f"observation.images.{view}"].numpy().transpose(1, 2, 0) * 255).round().astype(np.uint8)
        np.testing.assert_array_equal(held, pictures[0])
    envs.close()


@needs_lerobot
def test_unknown_environments_are_named(plugin: Any) -> None:
    with pytest.raises(UnknownNameError, match="MoveToRegion"):
        plugin.MagicalConfig(task="MoveToRegoin").create_envs(1)
    with pytest.raises(UnknownNameError, match="unknown choice of views 'top'"):
        plugin.LeRobotEnv("MoveToRegion", "Demo", "top")


@needs_lerobot
def test_the_folder_for_the_hub_is_what_lerobot_loads_from_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from lerobot.envs.factory import make_env

    repository, revision = tmp_path / "models--magical--mj", "0" * 40
    shutil.copytree(ROOT / "hub" / "lerobot", repository / "snapshots" / revision)  # as the hub's client caches it
    (repository / "refs").mkdir()
    (repository / "refs" / "main").write_text(revision)
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    suites = make_env("magical/mj", n_envs=2, hub_cache_dir=str(tmp_path), trust_remote_code=True)
    assert list(suites) == list(magical_mj.TASKS)
    vector = suites["MoveToRegion"][0]
    observation, infos = vector.reset(seed=[0, 1])
    assert observation["pixels"].shape == (2, 96, 96, 3)
    assert not infos.get("is_success", np.zeros(2)).any()
    drive = np.tile(np.array([1, 0, 0], np.float32), (2, 1))
    for _ in range(40):
        _, rewards, _, truncated, infos = vector.step(drive)
    assert truncated.all()
    assert infos["final_info"]["is_success"].tolist() == (rewards == 1).tolist()
    for suite in suites.values():
        suite[0].close()


@pytest.mark.skipif(
    find_spec("huggingface_hub") is None, reason="lerobot is missing: make integrations-test LIBRARY=lerobot"
)
@pytest.mark.parametrize("kind", ["model", "dataset"])
def test_uploads_to_the_hub_are_whole(kind: str, tmp_path: Path) -> None:
    """By the hub's own command to a stand-in, as the pages say: hub/lerobot, and an export of demonstrations."""
    import yaml

    folder, arrived = ROOT / "hub" / "lerobot", tmp_path / "arrived"
    if kind == "dataset":
        folder = to_webdataset(magical_mj.demos.load("MoveToRegion")[:1], tmp_path / "set", "State").parent
    command = [sys.executable, ROOT / "tools" / "hub.py", folder, "--type", kind, "--out", arrived]
    subprocess.run(command, check=True)
    assert {path.name for path in arrived.iterdir()} == {path.name for path in folder.iterdir() if path.is_file()}
    assert yaml.safe_load((arrived / "README.md").read_text().split("---")[1])["license"] == "apache-2.0"
