"""Policies from files: what is loaded without trust, what is not, and what does not fit."""

from __future__ import annotations

import base64
import importlib
import io
import json
import os
import pickle
import resource
import sys
import warnings
import zipfile
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pandas as pd
import pytest
from gymnasium import spaces

import magical_mj
from magical_mj.policies import models
from magical_mj.policies.interface import Episode, letters_of
from magical_mj.policies.models import load_onnx, load_sb3
from magical_mj.utils.errors import EvaluationError, MissingExtraError, SettingsError

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning")

STATE, PIXELS = "magical_mj/MoveToRegion-Demo-State-v0", "magical_mj/MoveToRegion-Demo-LoRes4E-v0"
SMALL: dict[str, Any] = {"tasks": "MoveToRegion", "variants": "Layout", "episodes": 2}


def ppo(path: Path, kind: str, env: Any, **kwargs: Any) -> Any:
    sb3 = pytest.importorskip("stable_baselines3")
    model = sb3.PPO(kind, env, n_steps=8, batch_size=8, device="cpu", seed=0, **kwargs)
    model.save(path)
    return model


@pytest.mark.parametrize(
    ("algorithm", "kind", "name", "kwargs"),
    [
        ("PPO", "MlpPolicy", STATE, {}),
        ("PPO", "MlpPolicy", STATE, {"net_arch": [16, 8]}),
        ("PPO", "MlpPolicy", STATE, {"net_arch": [16], "activation_fn": "ELU"}),
        ("PPO", "CnnPolicy", PIXELS, {}),
        ("A2C", "MlpPolicy", STATE, {}),
        ("DQN", "MlpPolicy", STATE, {"activation_fn": "SiLU"}),
        ("DQN", "CnnPolicy", PIXELS, {}),
    ],
)
def test_standard_networks_need_no_trust(
    tmp_path: Path, algorithm: str, kind: str, name: str, kwargs: dict[str, Any]
) -> None:
    sb3, nn = pytest.importorskip("stable_baselines3"), pytest.importorskip("torch").nn
    kwargs = {key: getattr(nn, value) if key == "activation_fn" else value for key, value in kwargs.items()}
    memory = {"buffer_size": 1} if algorithm == "DQN" else {}
    model = getattr(sb3, algorithm)(kind, name, device="cpu", seed=0, policy_kwargs=kwargs, **memory)
    with sys.modules["torch"].no_grad():
        for parameter in model.policy.parameters():
            parameter *= 2  # a new network chooses nearly the same action everywhere
    model.save(tmp_path / "model.zip")
    loaded = load_sb3(tmp_path / "model.zip")
    env = gymnasium.make(name)
    observation, _ = env.reset(seed=3)
    observations = [observation, *(env.step(action)[0] for action in (1, 4, 10, 13))]
    expected = [int(model.predict(observation, deterministic=True)[0]) for observation in observations]
    assert [int(loaded(observation)) for observation in observations] == expected
    np.testing.assert_array_equal(loaded.act_batch(np.stack(observations)), expected)
    torch = sys.modules["torch"]
    torch.set_default_dtype(torch.float64)
    try:  # whatever its user has set
        assert [int(load_sb3(tmp_path / "model.zip")(observation)) for observation in observations] == expected
    finally:
        torch.set_default_dtype(torch.float32)


def test_evaluating_an_archive(tmp_path: Path) -> None:
    ppo(tmp_path / "model.zip", "MlpPolicy", STATE)
    frame = magical_mj.evaluate(str(tmp_path / "model.zip"), preset="State", **SMALL)
    assert frame["failure"].isna().all()
    assert set(frame["policy"]) == {"model"}
    alone = magical_mj.evaluate({"model": load_sb3(tmp_path / "model.zip").__call__}, preset="State", **SMALL)
    pd.testing.assert_frame_equal(*(played.drop(columns="seconds") for played in (frame, alone)))


@pytest.mark.parametrize(("kind", "name", "fits"), [("MlpPolicy", STATE, "State"), ("CnnPolicy", PIXELS, "LoRes4E")])
def test_the_wrong_preset_is_refused_before_anything_is_played(tmp_path: Path, kind: str, name: str, fits: str) -> None:
    ppo(tmp_path / "model.zip", kind, name)
    wrong = {"State": "LoRes4E", "LoRes4E": "State"}[fits]
    with pytest.raises(
        SettingsError, match=f"takes observations of shape .* and {wrong} gives .*: give --preset {fits}"
    ):
        magical_mj.evaluate(str(tmp_path / "model.zip"), preset=wrong, out=tmp_path / "out", **SMALL)
    assert not (tmp_path / "out").exists()


def test_an_answer_that_is_no_number_is_a_failure(tmp_path: Path) -> None:
    model = ppo(tmp_path / "model.zip", "MlpPolicy", STATE)
    torch = pytest.importorskip("torch")
    with torch.no_grad():
        model.policy.action_net.bias.fill_(float("nan"))
    model.save(tmp_path / "model.zip")
    with pytest.raises(EvaluationError, match=r"the first 2 episodes of model failed.*nan"):
        magical_mj.evaluate(str(tmp_path / "model.zip"), preset="State", **SMALL)


def test_networks_of_dicts_need_trust(tmp_path: Path) -> None:
    ppo(tmp_path / "model.zip", "MultiInputPolicy", "magical_mj/MoveToRegion-Demo-LoResStack-v0")
    with pytest.raises(SettingsError, match=r"--trust \(trust=True\)"):
        load_sb3(tmp_path / "model.zip")
    frame = magical_mj.evaluate(str(tmp_path / "model.zip"), preset="LoResStack", trust=True, **SMALL)
    assert frame["failure"].isna().all()


def test_special_networks_need_trust(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch")
    model = ppo(tmp_path / "model.zip", "MlpPolicy", STATE, policy_kwargs={"activation_fn": torch.nn.Hardtanh})
    with pytest.raises(SettingsError, match=r"pickle; --trust \(trust=True\) loads it and runs the code"):
        load_sb3(tmp_path / "model.zip")
    observation, _ = gymnasium.make(STATE).reset(seed=0)
    loaded = load_sb3(tmp_path / "model.zip", trust=True)
    assert loaded(observation) == model.predict(observation, deterministic=True)[0]


RECURRENT = """
import numpy as np
from stable_baselines3.common.policies import ActorCriticPolicy

class Counting(ActorCriticPolicy):
    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        state = np.zeros(len(observation), int) if state is None else state + 1
        return state % 18, state
"""


def test_the_state_of_a_recurrent_policy_is_kept_for_an_episode(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As `sb3_contrib.RecurrentPPO` has one. Each episode starts without a state, alone and in a batch."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "counting_policy.py").write_text(RECURRENT)
    model = ppo(tmp_path / "model.zip", importlib.import_module("counting_policy").Counting, STATE)
    with pytest.raises(SettingsError, match="--trust"):
        load_sb3(tmp_path / "model.zip")  # its weights are those of a standard network, but it acts otherwise
    alike = magical_mj.evaluate(str(tmp_path / "model.zip"), preset="State", trust=True, jobs=1, **SMALL)
    loaded, counted = load_sb3(tmp_path / "model.zip", trust=True), letters_of(step % 18 for step in range(40))
    for seed in (0, 1):
        loaded.reset(Episode("MoveToRegion", "Layout", seed))
        assert letters_of(int(loaded(np.zeros(185, np.float32))) for _ in range(40)) == counted
    assert alike["actions"].tolist() == [counted] * 2
    torch = sys.modules["torch"]
    with torch.no_grad():
        model.policy.action_net.bias.fill_(float("nan"))
    model.save(tmp_path / "model.zip")
    with pytest.raises(SettingsError, match="weights that are not numbers"):
        load_sb3(tmp_path / "model.zip", trust=True)


def test_arguments_of_another_network_need_trust(tmp_path: Path) -> None:
    ppo(tmp_path / "model.zip", "MlpPolicy", STATE)
    with zipfile.ZipFile(tmp_path / "model.zip") as good, zipfile.ZipFile(tmp_path / "lstm.zip", "w") as other:
        for name in good.namelist():
            content = good.read(name)
            if name == "data":
                content = json.dumps(json.loads(content) | {"policy_kwargs": {"lstm_hidden_size": 16}}).encode()
            other.writestr(name, content)
    with pytest.raises(SettingsError, match=r"not contain a standard network \(.*lstm_hidden_size.*; --trust"):
        load_sb3(tmp_path / "lstm.zip")


class Attack:
    def __reduce__(self) -> Any:
        return Path.touch, (Path("attacked"),)


def test_no_pickle_is_read_without_trust(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    ppo(tmp_path / "model.zip", "MlpPolicy", STATE)
    poison = base64.b64encode(pickle.dumps(Attack())).decode()
    with zipfile.ZipFile("model.zip") as good, zipfile.ZipFile("bad.zip", "w") as bad:
        for name in good.namelist():
            content = good.read(name)
            if name == "data":
                data = json.loads(content)
                for value in data.values():
                    if isinstance(value, dict) and ":serialized:" in value:
                        value[":serialized:"] = poison
                content = json.dumps(data).encode()
            bad.writestr(name, content)
        bad.writestr("pytorch_variables.pth", pickle.dumps(Attack()))
    load_sb3(Path("bad.zip"))
    with zipfile.ZipFile("worse.zip", "w") as worse:
        worse.writestr("data", "{}")
        worse.writestr("policy.pth", pickle.dumps(Attack()))
    with (
        warnings.catch_warnings(record=True) as told,
        pytest.raises(SettingsError, match="weights that are not tensors"),
    ):
        load_sb3(Path("worse.zip"))
    assert not told
    assert not Path("attacked").exists()


class Other(gymnasium.Env[Any, Any]):
    """Has the state for an observation and other actions."""

    observation_space = gymnasium.make(STATE).observation_space
    action_space = spaces.Discrete(4)

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        return self.observation_space.sample(), {}


def test_other_actions_are_refused(tmp_path: Path) -> None:
    ppo(tmp_path / "model.zip", "MlpPolicy", Other())
    for trust in (False, True):
        with pytest.raises(SettingsError, match=r"an action must be an integer from 0 to 17; .*to_discrete"):
            magical_mj.evaluate(str(tmp_path / "model.zip"), preset="State", trust=trust, **SMALL)


@pytest.mark.parametrize(
    ("content", "weights", "trust", "complaint"),
    [
        (b"", ..., False, "not a stable-baselines3 archive"),
        (b"PK\x05\x06" + 18 * b"\0", ..., False, "not a stable-baselines3 archive"),
        (
            json.dumps(list(range(3000))).encode(),
            "damaged",
            False,
            "not .* archive: error: Error -3 while decompressing",
        ),
        (b"[]", {}, False, "not a stable-baselines3 archive"),
        (b"{}", None, False, "weights that are not tensors"),
        (b"{}", [], False, "weights that are not tensors"),
        (
            b'{"policy_kwargs": {}, "observation_space": 3}',
            {"action_net.weight": 1},
            False,
            "does not describe its net",
        ),
        (b"{}", {}, True, "does not describe its network: KeyError: 'policy_class'"),
    ],
)
def test_archives_that_are_not_whole(tmp_path: Path, content: bytes, weights: Any, trust: bool, complaint: str) -> None:
    """Without weights, the content is that of the file; else it is the archive's JSON."""
    torch, path = pytest.importorskip("torch"), tmp_path / "model.zip"
    path.write_bytes(content)
    if weights is not ...:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("data", content)
            with archive.open("policy.pth", "w") as file:
                if weights is not None:
                    torch.save(weights, file)
    if weights == "damaged":
        path.write_bytes(path.read_bytes()[:60] + bytes(20) + path.read_bytes()[80:])
    with pytest.raises(SettingsError, match=complaint):
        load_sb3(path, trust)


def rewritten(path: Path, **changes: Any) -> Path:
    """An archive with other values in its JSON."""
    new = path.with_name("new.zip")
    with zipfile.ZipFile(path) as archive, zipfile.ZipFile(new, "w", zipfile.ZIP_DEFLATED) as other:
        other.writestr("data", json.dumps(json.loads(archive.read("data")) | changes))
        other.writestr("policy.pth", archive.read("policy.pth"))
    return new


def test_small_files_of_large_models_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By what they declare, before the memory is taken."""
    ppo(tmp_path / "model.zip", "MlpPolicy", STATE)
    for changes, bound in (
        ({"policy_kwargs": {"net_arch": [40_000, 40_000]}}, "100,000,000 parameters"),
        ({"policy_kwargs": {"net_arch": [2] * 10_000}}, "10,000 characters"),
        ({"observation_space": {"_shape": [1_000_000, 1_000_000], "dtype": "float32"}}, "10,000,000 values"),
    ):
        with pytest.raises(SettingsError, match=bound):
            load_sb3(rewritten(tmp_path / "model.zip", **changes))
    monkeypatch.setattr(models, "MOST_SETTINGS", 20_000_000)
    monkeypatch.setattr(models, "MOST_OF_POLICY", 20_000_000)
    with pytest.raises(SettingsError, match="its data has more than 20,000,000 bytes"):
        load_sb3(rewritten(tmp_path / "model.zip", filler=" " * 20_000_000))
    with zipfile.ZipFile(tmp_path / "bomb.zip", "w") as archive, io.BytesIO() as inner:
        with zipfile.ZipFile(inner, "w", zipfile.ZIP_DEFLATED) as weights:
            weights.writestr("archive/data/0", bytes(20_000_001))
        archive.writestr("data", "{}")
        archive.writestr("policy.pth", inner.getvalue())
    assert (tmp_path / "bomb.zip").stat().st_size < 100_000
    with pytest.raises(SettingsError, match="its weights have more than 20,000,000 bytes"):
        load_sb3(tmp_path / "bomb.zip")


def test_model_files_that_are_pipes_or_folders_are_refused(tmp_path: Path) -> None:
    """Reading a pipe would wait without end."""
    os.mkfifo(tmp_path / "pipe.zip")
    (tmp_path / "link.onnx").symlink_to(tmp_path / "pipe.zip")
    (tmp_path / "folder.zip").mkdir()
    for name in ("pipe.zip", "link.onnx", "folder.zip"):
        with pytest.raises(SettingsError, match="not a plain file"):
            magical_mj.evaluate(tmp_path / name, **SMALL)


def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "stable_baselines3.common.policies", None)
    with pytest.raises(MissingExtraError, match=r"model\.zip needs stable-baselines3: pip install"):
        load_sb3(tmp_path / "model.zip")


def linear(path: Path, outputs: int, *, declared: bool = True) -> np.ndarray:
    """Writes an ONNX file: the state times a matrix, which is returned. Its number of outputs need not be declared."""
    onnx = pytest.importorskip("onnx")
    helper, kind = onnx.helper, onnx.TensorProto.FLOAT
    size = gymnasium.make(STATE).observation_space.shape[0]
    matrix = np.random.default_rng(0).normal(size=(size, outputs)).astype(np.float32)
    graph = helper.make_graph(
        [
            helper.make_node("MatMul", ["seen", "matrix"], ["values" if declared else "product"]),
            *([] if declared else [helper.make_node("Compress", ["product", "all"], ["values"], axis=1)]),
        ],
        "linear",
        [helper.make_tensor_value_info("seen", kind, [None, size])],
        [helper.make_tensor_value_info("values", kind, [None, outputs if declared else "values"])],
        [onnx.numpy_helper.from_array(matrix, "matrix"), onnx.numpy_helper.from_array(np.ones(outputs, bool), "all")],
    )
    onnx.save(helper.make_model(graph, ir_version=10, opset_imports=[helper.make_opsetid("", 18)]), path)
    return matrix


def test_onnx_file_acts_by_the_best_value(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    matrix = linear(tmp_path / "model.onnx", 18)
    loaded = load_onnx(tmp_path / "model.onnx")
    observation, _ = gymnasium.make(STATE).reset(seed=3)
    assert loaded(observation) == np.argmax(observation @ matrix)
    frame = magical_mj.evaluate(str(tmp_path / "model.onnx"), preset="State", **SMALL)
    assert frame["failure"].isna().all()


def test_onnx_files_that_do_not_fit(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    linear(tmp_path / "model.onnx", 4)
    with pytest.raises(SettingsError, match="outputs 4 values for an observation, but there are 18 actions"):
        magical_mj.evaluate(str(tmp_path / "model.onnx"), preset="State", **SMALL)
    for outputs in (3, 17, 19):  # such as a vector of a continuous action, whose largest entry is no action
        linear(tmp_path / "model.onnx", outputs, declared=False)
        with pytest.raises(EvaluationError, match=rf"outputs {outputs} values for an observation, but there are 18"):
            magical_mj.evaluate(str(tmp_path / "model.onnx"), preset="State", **SMALL)
    linear(tmp_path / "state.onnx", 18)
    with pytest.raises(SettingsError, match=r"takes observations of shape .* give --preset State"):
        magical_mj.evaluate(str(tmp_path / "state.onnx"), preset="LoRes4E", **SMALL)
    (tmp_path / "broken.onnx").write_bytes(b"nothing")
    with pytest.raises(SettingsError, match="not a valid ONNX file"):
        magical_mj.evaluate(str(tmp_path / "broken.onnx"), preset="State", **SMALL)


@pytest.mark.parametrize("grows", [False, True])
def test_onnx_files_take_only_so_much_memory(tmp_path: Path, grows: bool) -> None:
    """A file of a few hundred bytes with a value of 4 GB in it, whether it depends on the batch's size or not."""
    onnx = pytest.importorskip("onnx")
    helper, kind, array = onnx.helper, onnx.TensorProto.FLOAT, onnx.numpy_helper.from_array
    graph = helper.make_graph(
        [
            helper.make_node("Shape", ["seen"], ["shape"]),
            helper.make_node("Gather", ["shape", "first"], ["batch"]),
            helper.make_node("Mul", ["batch", "most"], ["size"])
            if grows
            else helper.make_node("Identity", ["most"], ["size"]),
            helper.make_node("ConstantOfShape", ["size"], ["large"]),
            helper.make_node("ReduceSum", ["large"], ["sum"], keepdims=0),
            helper.make_node("Add", ["seen", "sum"], ["values"]),
        ],
        "large",
        [helper.make_tensor_value_info("seen", kind, [None, 18])],
        [helper.make_tensor_value_info("values", kind, [None, 18])],
        [array(np.array([10**9]), "most"), array(np.array([0]), "first")],
    )
    onnx.save(helper.make_model(graph, ir_version=10, opset_imports=[helper.make_opsetid("", 18)]), tmp_path / "a.onnx")
    assert (tmp_path / "a.onnx").stat().st_size < 1000
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(MemoryError, match=r"a\.onnx needs more than the 2,000,000,000 bytes"):
        load_onnx(tmp_path / "a.onnx")(np.zeros(18, np.float32))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 1_000_000  # kB
