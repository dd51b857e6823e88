"""Policies that lerobot trains: their checkpoints are evaluated like any policy; the configurations in results/."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import gymnasium
import pytest

import magical_mj
from magical_mj.policies.interface import Episode
from magical_mj.utils.errors import MagicalError, SettingsError

pytest.importorskip("lerobot", reason="lerobot is missing: make integrations-test LIBRARY=lerobot")

from magical_mj.integrations import lerobot as plugin

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.filterwarnings("default")  # lerobot's own are not ours to mend


@pytest.fixture(autouse=True)
def temporary(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """LeRobot leaves a temporary file behind for each configuration that it reads."""
    folder = str(tmp_path_factory.mktemp("temporary"))
    monkeypatch.setattr(tempfile, "tempdir", folder)
    monkeypatch.setenv("TMPDIR", folder)


def tiny_checkpoint(folder: Path, **options: Any) -> Path:
    """An untrained ACT policy as lerobot saves it."""
    import torch
    from lerobot.policies.act.configuration_act import ACTConfig
    from lerobot.policies.act.modeling_act import ACTPolicy
    from lerobot.policies.factory import make_pre_post_processors

    env = plugin.MagicalConfig(**options)
    features = {env.features_map[name]: feature for name, feature in env.features.items()}
    for feature in features.values():
        feature.shape = (3, 96, 96) if feature.shape == (96, 96, 3) else feature.shape
    config = ACTConfig(
        input_features={name: feature for name, feature in features.items() if name != "action"},
        output_features={"action": features["action"]},
        device="cpu", chunk_size=8, n_action_steps=8, dim_model=64, n_heads=2, dim_feedforward=64, n_encoder_layers=1,
        pretrained_backbone_weights=None,
    )  # fmt: skip
    torch.manual_seed(0)
    ACTPolicy(config).save_pretrained(folder)
    stats = {"action": {"mean": torch.zeros(3), "std": torch.ones(3)}}
    for part in make_pre_post_processors(config, dataset_stats=stats):
        part.save_pretrained(folder)
    return folder


OBSERVED = [
    ({}, "LoRes4E"),
    ({"views": "both"}, "LoResStack"),
    ({"views": "state"}, "State"),
    ({"views": "allo", "fingers": True}, "LoResFingers"),
    ({"views": "state", "fingers": True}, "State"),
]


@pytest.mark.parametrize(("options", "preset"), OBSERVED)
def test_a_checkpoint_is_evaluated_like_any_policy(tmp_path: Path, options: dict[str, Any], preset: str) -> None:
    folder = tiny_checkpoint(tmp_path / "pretrained_model", **options)
    played = {"tasks": "MoveToRegion", "variants": "Demo,Layout", "episodes": 2, "preset": preset, "jobs": 1}
    runs = [magical_mj.evaluate(str(folder), **played) for _ in range(2)]
    assert runs[0]["failure"].isna().all()
    assert list(runs[0]["actions"]) == list(runs[1]["actions"])
    assert len(runs[0]) == 4


@pytest.mark.parametrize(("options", "preset"), OBSERVED)
def test_a_checkpoint_sees_here_what_it_sees_in_lerobot(tmp_path: Path, options: dict[str, Any], preset: str) -> None:
    """Its first action is the same here and by lerobot's own steps."""
    import torch
    from lerobot.envs.utils import preprocess_observation
    from lerobot.policies.act.modeling_act import ACTPolicy

    folder = tiny_checkpoint(tmp_path / "pretrained_model", **options)
    policy, theirs = plugin.load_checkpoint(folder), ACTPolicy.from_pretrained(folder).eval()
    env, ours = plugin.LeRobotEnv("FixColour", "Demo", **options), gymnasium.make(
        magical_mj.env_id("FixColour", "Demo", preset)
    )  # fmt: skip
    seen, _ = env.reset(seed=3)
    observation, _ = ours.reset(seed=3)
    generator = torch.get_rng_state()
    policy.reset(Episode("FixColour", "Demo", 3, 3))
    with torch.inference_mode():
        wanted = theirs.select_action(preprocess_observation({name: _batch(value) for name, value in seen.items()}))
    assert policy(observation) == magical_mj.actions.to_discrete(wanted[0].numpy())
    assert torch.equal(torch.get_rng_state(), generator)  # which is the user's
    env.close()
    ours.close()


def test_a_checkpoint_gets_the_sentence_and_act_does_not_read_it(tmp_path: Path) -> None:
    folder, sentences = tiny_checkpoint(tmp_path / "pretrained_model", views="state"), []
    policy = plugin.load_checkpoint(folder)
    before = policy._before
    policy._before = lambda batch: (sentences.extend(batch["task"]), before(batch))[1]  # what the checkpoint gets
    state, _ = gymnasium.make("magical_mj/FixColour-Demo-State-v0").reset(seed=3)
    policy.reset(Episode("FixColour", "Demo", 3, instruction="put it elsewhere"))
    policy(state)
    assert sentences == ["put it elsewhere"]
    with pytest.raises(SettingsError, match="does not notice the shift words"):
        magical_mj.evaluate(str(folder), tasks="FixColour", episodes=1, preset="State", shifts="words:5")


def _batch(value: Any) -> Any:
    return {view: picture[None] for view, picture in value.items()} if isinstance(value, dict) else value[None]


def test_checkpoints_of_other_observations_are_refused(tmp_path: Path) -> None:
    folder = tiny_checkpoint(tmp_path / "pretrained_model")
    with pytest.raises(MagicalError, match="--preset LoRes4E"):
        magical_mj.evaluate(str(folder), tasks="MoveToRegion", episodes=1, preset="LoRes4A")
    original = (folder / "config.json").read_text()
    for change, said in (
        (lambda config: config["input_features"].update(wrist=config["input_features"]["observation.image"]), "wrist"),
        (lambda config: config["input_features"]["observation.image"].update(shape=[3, 84, 84]), "84, 84"),
        (lambda config: config["output_features"]["action"].update(shape=[7]), r"\(7,\)"),
    ):
        config = json.loads(original)
        change(config)
        (folder / "config.json").write_text(json.dumps(config))
        with pytest.raises(SettingsError, match=said):
            plugin.load_checkpoint(folder)


@pytest.mark.parametrize(
    "path",
    sorted([*ROOT.glob("results/*/train.json"), *ROOT.glob("tools/full_size/*.json")]),
    ids=lambda path: path.parent.name,
)
def test_lerobot_understands_the_experiments(path: Path) -> None:
    import draccus
    from lerobot.configs.train import TrainPipelineConfig
    from lerobot.policies.factory import get_policy_class

    config = draccus.parse(TrainPipelineConfig, path, args=[])
    assert config.policy is not None
    assert get_policy_class(config.policy.type).config_class is type(config.policy)
    assert config.policy.device == "cpu"
    assert path.parent.name.endswith("-state") or config.policy.pretrained_backbone_weights is None
