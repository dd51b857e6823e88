"""Frozen encoders: what is trained and what is not, what they declare, and what does not fit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from magical_mj.evaluation import evaluate
from magical_mj.leaderboard import submit, verify
from magical_mj.learners import TrainingSettings, checkpoint, clone, load_policy, train
from magical_mj.learners.bc import BehaviouralCloning
from magical_mj.learners.encoder import Encoder, save_encoder
from magical_mj.learners.networks import Torso
from magical_mj.learners.policy import export_policy
from magical_mj.utils.errors import SettingsError, TrainingError
from tests.helpers.commands import Shell
from tests.helpers.learners import EXPORTS, TINY, check_resumes, compare_exported, playing, stopped, tiny

PREFIX = "torso.convolutions."


def random_encoder(path: Path, played_in: str = "Demo", seed: int = 7, task: str = "MoveToRegion") -> Encoder:
    """Random convolutions, with averages of batch norm that a batch would not have."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        layers = Torso(tiny().network, batch_norm=True).convolutions
        for name, values in layers.state_dict().items():
            if name.endswith("running_mean"):
                values.uniform_(-0.3, 0.3)
            if name.endswith("running_var"):
                values.uniform_(0.1, 0.3)
    encoder = Encoder(layers.state_dict(), (task,), played_in)
    save_encoder(path, encoder, overwrite=True)
    return encoder


def using(encoder: Path, **changes: Any) -> TrainingSettings:
    """Settings of a tiny training with this encoder."""
    return tiny(**{"bc.encoder": encoder, **changes})


def convolutions_of(folder: Path) -> dict[str, torch.Tensor]:
    state = load_policy(folder).actor.state_dict()
    return {name.removeprefix(PREFIX): values for name, values in state.items() if name.startswith(PREFIX)}


@pytest.mark.parametrize("tasks", ["MoveToRegion", "MoveToRegion,FixColour"])
def test_only_layers_after_the_encoder_are_trained(tasks: str, tmp_path: Path) -> None:
    """The weights and the averages of batch norm are those of the file after training, recalibration and loading."""
    encoder = random_encoder(tmp_path / "encoder.safetensors")
    settings = using(tmp_path / "encoder.safetensors", tasks=tasks)
    before = BehaviouralCloning(settings).actor.state_dict()
    train(settings, tmp_path / "run")
    after = load_policy(tmp_path / "run").actor.state_dict()
    assert convolutions_of(tmp_path / "run").keys() == encoder.weights.keys()
    for name, values in convolutions_of(tmp_path / "run").items():
        assert torch.equal(values, encoder.weights[name])
    trained = [name for name in before if not name.startswith(PREFIX)]
    assert trained
    assert not any(torch.equal(before[name], after[name]) for name in trained)


def test_training_uses_the_encoders_features(tmp_path: Path) -> None:
    """The first loss is that of the file's weights in evaluation mode, which differ from those of a batch."""
    encoder = random_encoder(tmp_path / "encoder.safetensors")
    settings = using(tmp_path / "encoder.safetensors", augment="none")
    before = torch.get_rng_state()
    learner, twin = BehaviouralCloning(settings), BehaviouralCloning(settings)
    assert torch.equal(torch.get_rng_state(), before)
    reference = Torso(settings.network, batch_norm=True).eval()
    reference.convolutions.load_state_dict(dict(encoder.weights))
    reference.linear.load_state_dict(twin.actor.torso.linear.state_dict())
    observations, actions, tasks = twin.data.sample(settings.bc.batch_size, twin.rng)
    logits = twin.actor.head(reference(observations.permute(0, 3, 1, 2) / 255), tasks)
    wanted = torch.nn.functional.cross_entropy(logits, actions).item()
    assert learner.update()["loss"] == pytest.approx(wanted, rel=1e-4)


def test_a_trainings_own_encoder_is_used_again(shell: Shell, tmp_path: Path) -> None:
    """By the command, with the folder of another training; also one that itself had a frozen encoder."""
    random_encoder(tmp_path / "encoder.safetensors", "Layout,All")
    train(using(tmp_path / "encoder.safetensors"), tmp_path / "first")
    few = {**TINY, "bc.batches": 3, "bc.encoder": tmp_path / "first"}
    changes = [
        part
        for name, value in few.items()
        if "." in name and "entity" not in name
        for part in ("--set", f"{name}={value}")
    ]
    command = ["train", "bc", "--tasks", "FixColour", "--quick", "--device", "cpu", "--out", "second"]
    code, _, error = shell(*command, *changes)
    assert code == 0, error
    second = convolutions_of(Path("second"))
    assert all(torch.equal(values, second[name]) for name, values in convolutions_of(tmp_path / "first").items())
    assert load_policy("second").learnt.played_in == "Demo,Layout,All"


def test_a_training_with_an_encoder_resumes(tmp_path: Path) -> None:
    random_encoder(tmp_path / "encoder.safetensors")
    check_resumes("bc", {"bc.encoder": tmp_path / "encoder.safetensors"}, tmp_path)
    settings = using(tmp_path / "encoder.safetensors")
    stopped(tmp_path / "run", settings)
    random_encoder(tmp_path / "encoder.safetensors", seed=8)
    with pytest.raises(TrainingError, match=r"the encoder in .*encoder\.safetensors has changed since .*run was begun"):
        train(settings, tmp_path / "run", resume=True)


@EXPORTS
def test_policies_declare_the_scenes_and_tasks_of_their_encoder(tmp_path: Path) -> None:
    """Those in memory, in a run's folder, and exported; an entry that does not declare them is refused."""
    random_encoder(tmp_path / "encoder.safetensors", "Demo,Layout,All", task="FindDupe")
    settings = using(tmp_path / "encoder.safetensors")
    assert clone(settings, out=tmp_path / "run").learnt.played_in == "Demo,Layout,All"
    (tmp_path / "encoder.safetensors").unlink()  # the run's folder is enough
    export_policy(tmp_path / "run", tmp_path / "exported.onnx")
    seen = np.random.default_rng(0).integers(0, 256, (2, 96, 96, 12), np.uint8)
    compare_exported(load_policy(tmp_path / "run").actor, tmp_path / "exported.onnx", seen)
    card = tmp_path / "card.toml"
    where = {"tasks": "MoveToRegion", "variants": "Demo", "episodes": 1, "jobs": 1}
    for name in ("run", "exported.onnx"):
        card.write_text("privileges = []")
        evaluate({"BC": tmp_path / name}, out=tmp_path / f"scores of {name}", **where)
        with pytest.raises(SettingsError, match=r'BC learnt in scenes of All, Layout: add "other scenes" to'):
            submit([tmp_path / f"scores of {name}"], tmp_path / "entry.json.xz", card=card)
        card.write_text('privileges = ["other scenes"]')
        with pytest.raises(SettingsError, match="BC has an encoder or a reward of FindDupe: name them in the card's"):
            submit([tmp_path / f"scores of {name}"], tmp_path / "entry.json.xz", card=card)
        card.write_text('privileges = ["other scenes"]\n[demonstrations]\nother = "an encoder of FindDupe"')
        entry = submit([tmp_path / f"scores of {name}"], tmp_path / f"{name}.json.xz", card=card)
        assert (entry.played_in, entry.other_tasks) == (["All", "Layout"], ["FindDupe"])


@pytest.mark.parametrize(("encoder", "training"), [(1, 2), (2, 1)])
def test_encoders_of_another_set_are_refused(encoder: int, training: int, tmp_path: Path) -> None:
    """Also in the folder of a training. An encoder that learnt from none of the sets fits all trainings."""
    file = tmp_path / "encoder.safetensors"
    found = random_encoder(file)._replace(demonstration_set=encoder)
    save_encoder(file, found, overwrite=True)
    sets: list[dict[str, Any]] = [{"demos.set": encoder}, {"demos.set": training}]
    train(using(file, **sets[0]), tmp_path / "run")
    for path in (file, tmp_path / "run"):
        problem = rf"learnt with demos\.set={encoder}, and this training would with demos\.set={training}: use one"
        with pytest.raises(SettingsError, match=problem):
            train(using(path, **sets[1]), tmp_path / "new")
    save_encoder(file, found._replace(demonstration_set=0), overwrite=True)
    assert clone(using(file, **sets[1])).learnt.demonstration_set == training


def test_entries_name_the_other_tasks_of_an_encoder(tmp_path: Path) -> None:
    """Also those of the encoder's own encoder, and in entries whose card is changed later."""
    random_encoder(tmp_path / "encoder.safetensors", task="FindDupe")
    assert clone(using(tmp_path / "encoder.safetensors"), out=tmp_path / "first").learnt.other_tasks == ["FindDupe"]
    random_encoder(tmp_path / "encoder.safetensors", task="MakeLine")
    settings = using(tmp_path / "first", tasks="FixColour")
    assert clone(settings, out=tmp_path / "second").learnt.other_tasks == ["MoveToRegion", "FindDupe"]
    where = {"tasks": "FixColour", "variants": "Demo", "episodes": 1, "jobs": 1}
    evaluate({"BC": tmp_path / "second"}, out=tmp_path / "scores", **where)
    card, entry = tmp_path / "entry" / "card.toml", tmp_path / "entry" / "bc.json.xz"
    card.parent.mkdir()
    lacking = 'method = "BC"\nprivileges = []\n[demonstrations]\nother = "an encoder of MoveToRegion"'
    card.write_text(lacking)
    with pytest.raises(SettingsError, match="BC has an encoder or a reward of FindDupe: name them in the card's"):
        submit([tmp_path / "scores"], entry, card=card)
    card.write_text(f'{lacking[:-1]}, whose encoder learnt FindDupe"')
    assert submit([tmp_path / "scores"], entry, card=card).other_tasks == ["FindDupe", "MoveToRegion"]
    assert not verify(card.parent, jobs=1).unfit
    card.write_text(lacking)
    assert "reward of FindDupe: name them" in verify(card.parent, jobs=1).unfit[0]


def test_a_missing_encoder_is_reported_at_once(shell: Shell) -> None:
    error = shell.fails(2, "train", "bc", "--tasks", "FixColour", "--set", "bc.encoder=none.safetensors", "--out", "x")
    assert error.startswith("magical-mj: bc.encoder: cannot read")
    assert "No such file" in error


def test_encoders_that_do_not_fit_the_training_are_refused(tmp_path: Path) -> None:
    file, run = tmp_path / "encoder.safetensors", tmp_path / "run"

    def refused(match: str, kind: type[Exception] = SettingsError, path: Path = file, **changes: Any) -> None:
        with pytest.raises(kind, match=match):
            train(using(path, **changes), tmp_path / "new")
        assert not (tmp_path / "new").exists()

    refused("No such file .*; give the folder of a training, or")
    weights = random_encoder(file).weights
    refused("bc.encoder is for pictures", preset="State")
    larger: dict[str, Any] = {"network.first_channels": 8}
    refused("encoder.* has 0.weight of shape .*, not .*--quick in both trainings or in none", **larger)
    tasks = ("MoveToRegion",)
    incomplete = Encoder({name: values for name, values in weights.items() if name != "1.running_mean"}, tasks)
    with pytest.raises(TrainingError, match="exists already"):
        save_encoder(file, incomplete)
    save_encoder(file, incomplete, overwrite=True)
    refused("lacks 1.running_mean: give the folder of a training of bc, or")
    save_encoder(file, Encoder({**weights, "15.weight": torch.zeros(1)}, tasks), overwrite=True)
    refused("has 15.weight, which this network does not have")
    save_encoder(file, Encoder({**weights, "0.weight": weights["0.weight"] * torch.nan}, tasks), overwrite=True)
    refused("numbers in 0.weight that are not real and finite")
    with pytest.raises(SettingsError, match="played_in must be variants, separated by commas, not 'Elsewhere'"):
        save_encoder(file, Encoder(weights, tasks, "Elsewhere"))
    with pytest.raises(SettingsError, match="tasks must be a list of tasks, not 'FixColour'"):
        save_encoder(file, Encoder(weights, "FixColour"))
    for damage in (-1, "1", None):
        checkpoint.write(file, {"encoder": {**Encoder(dict(weights), tasks)._asdict(), "demonstration_set": damage}})
        refused("demonstration_set in .* must be a number of a set")
    checkpoint.write(file, {"weights": dict(weights)})
    refused("was not written by save_encoder of this version, so the tasks and variants of its training are unknown")
    save_file({name: values.contiguous() for name, values in weights.items()}, file)
    refused("cannot read .*; give the folder of a training, or a file written by save_encoder", TrainingError)
    train(playing("gail"), run)
    refused("lacks 1.bias", path=run)  # without batch norm
    train(tiny(preset="State"), tmp_path / "states")
    refused("has no convolutions: it is not for pictures", path=tmp_path / "states")
    (run / "config.toml").unlink()
    refused("is not the folder of a training", path=run)
    with pytest.raises(SettingsError, match=r"point trains its own convolutions: leave out bc\.encoder"):
        train(using(file, method="point"), tmp_path / "new")
    assert using(Path("near")).bc.encoder == str(Path("near").absolute())
