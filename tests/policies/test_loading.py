"""What users give as a policy: networks and models that need something around them, presets; the page's examples."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import magical_mj
from magical_mj.learners import train
from magical_mj.policies.models import load_onnx
from magical_mj.utils.errors import EvaluationError, SettingsError, UnknownNameError
from tests.helpers.commands import Shell
from tests.helpers.learners import tiny

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "policies.md").read_text("utf-8")
EXAMPLES = {name: code for code, name in re.findall(r"```python\n(# (\w+)\.py.*?)```", PAGE, re.DOTALL)}
STATE = "magical_mj/MoveToRegion-Demo-State-v0"
SMALL: dict[str, Any] = {"tasks": "MoveToRegion", "variants": "Demo,Layout", "episodes": 2, "jobs": 1}


@pytest.fixture
def example(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Writes a module of the page into the working folder, which is a fresh one."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    for name in EXAMPLES:
        monkeypatch.delitem(sys.modules, name, raising=False)

    def write(name: str) -> None:
        (tmp_path / f"{name}.py").write_text(EXAMPLES[name])

    return write


@pytest.mark.slow
@pytest.mark.xdist_group("exports")
@pytest.mark.filterwarnings("ignore::FutureWarning")  # of PyTorch's export
def test_a_network_is_evaluated_as_the_page_says(example: Callable[[str], None]) -> None:
    torch = pytest.importorskip("torch")
    pytest.importorskip("onnxscript")
    for name in ("network", "mine", "export"):
        example(name)
    from network import Network  # pyright: ignore[reportMissingImports]

    torch.manual_seed(0)
    network = Network()
    torch.save(network.state_dict(), "bc.pt")
    for policy in (network, Network, "network:Network", {"BC": network}):
        with pytest.raises(SettingsError, match=r"is a network, .*mine:Policy.*torch.onnx.export.*docs/policies.md"):
            magical_mj.evaluate(policy, **SMALL)
    with pytest.raises(SettingsError, match=r"bc.pt contains the weights of a network.*mine:Policy.*torch.onnx.export"):
        magical_mj.evaluate("bc.pt", **SMALL)
    exec(compile(EXAMPLES["export"], "export.py", "exec"), {"__name__": "export"})
    by_class, by_file = (magical_mj.evaluate(name, preset="LoRes4E", **SMALL) for name in ("mine:Policy", "bc.onnx"))
    with pytest.warns(UserWarning, match="bc .* preset LoRes4E, but observations of LoRes4A, LoRes3EA have the same"):
        assert list(magical_mj.evaluate("bc.onnx", **SMALL)["actions"]) == list(by_file["actions"])
    assert by_class["failure"].isna().all()
    assert by_class["actions"].nunique() > 1
    assert list(by_file["actions"]) == list(by_class["actions"])
    env: Any = gymnasium.make("magical_mj/MoveToRegion-TestLayout-LoRes4E-v0")
    (row,) = (row for row in by_class.itertuples() if (row.variant, row.seed) == ("Layout", 1))
    observation, _ = env.reset(seed=1)
    with torch.no_grad():
        assert network(torch.as_tensor(observation)[None]).argmax() == ord(row.actions[0]) - ord("a")


def test_a_class_derived_from_a_network_may_be_a_policy() -> None:
    torch = pytest.importorskip("torch")

    class Policy(torch.nn.Linear):
        def __call__(self, observation: Any) -> int:
            return int(super().__call__(torch.as_tensor(observation)).argmax())

    network = Policy(len(magical_mj.observations.STATE_NAMES), 18)
    assert magical_mj.evaluate({"it": network}, preset="State", **SMALL)["failure"].isna().all()


def test_a_reader_is_evaluated_as_the_page_says(example: Callable[[str], None]) -> None:
    example("reader")
    few: dict[str, Any] = {"tasks": "FixColour", "variants": "Demo", "episodes": 1, "jobs": 1}
    played = magical_mj.evaluate("reader:Policy", preset="LoResStack", shifts="words:1-5", **few)
    assert played["failure"].isna().all()
    assert len(played) == 6
    wanted = [magical_mj.Engine("FixColour", seed=0, shifts=shift).instruction for shift in played["shift"]]
    assert [ord(actions[0]) - ord("a") for actions in played["actions"]] == [len(text) % 18 for text in wanted]


def test_a_policy_of_vecnormalize_is_evaluated_as_the_page_says(example: Callable[[str], None]) -> None:
    sb3 = pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.logger import Logger
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    example("normalised")
    env = VecNormalize(DummyVecEnv([lambda: gymnasium.make("magical_mj/MoveToRegion-TestLayout-State-v0")]))
    model = sb3.PPO("MlpPolicy", env, n_steps=64, batch_size=64, n_epochs=1, device="cpu", seed=0)
    model.set_logger(Logger(None, []))  # the usual one makes a folder
    model.learn(128)
    model.save("model.zip")
    env.save("vecnormalize.pkl")
    with pytest.warns(UserWarning, match=r"model.zip is played without vecnormalize.pkl.* docs/policies.md shows"):
        without = magical_mj.evaluate("model.zip", **SMALL)
    played = magical_mj.evaluate("normalised:Policy", **SMALL)
    assert set(played["preset"]) == set(without["preset"]) == {"State"}
    env.training = False
    for row in played[played["variant"] == "Layout"].itertuples():
        env.seed(row.seed)
        observation, actions = env.reset(), ""
        for _ in range(row.steps):
            action, _ = model.predict(observation, deterministic=True)
            actions += "abcdefghijklmnopqr"[int(action[0])]
            observation, *_ = env.step(action)
        assert row.actions == actions
    assert list(played["actions"]) != list(without["actions"])
    Path("elsewhere").mkdir()
    Path("model.zip").rename("elsewhere/model.zip")  # no warning now, which would be an error
    magical_mj.evaluate("elsewhere/model.zip", **SMALL)


def test_a_model_of_stable_baselines3_gets_the_remedy() -> None:
    sb3 = pytest.importorskip("stable_baselines3")
    model = sb3.PPO("MlpPolicy", STATE, n_steps=8, batch_size=8, device="cpu", seed=0)
    for policy in (model, model.predict, model.policy, model.policy.predict):
        with pytest.raises(SettingsError, match=r'model.save\("model.zip"\).*lambda observation: model.predict'):
            magical_mj.evaluate({"it": policy}, preset="State", **SMALL)
    by_function = magical_mj.evaluate(
        {"it": lambda observation: model.predict(observation, deterministic=True)[0]}, preset="State", **SMALL
    )
    assert by_function["failure"].isna().all()


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("trained") / "run"
    train(tiny(preset="State"), folder)
    return folder


def test_runs_and_archives_are_played_with_their_own_preset(run: Path, shell: Shell, tmp_path: Path) -> None:
    options = ("--tasks", "MoveToRegion", "--variants", "Demo", "--episodes", "1", "--jobs", "1")
    code, printed, _ = shell("evaluate", "--policy", run, *options, "--out", "scores")
    assert code == 0
    assert "preset State, which the policy needs" in printed
    assert {score.preset for score in magical_mj.evaluation.scores.read(tmp_path / "scores")} == {"State"}
    assert "preset State" in shell("rollout", "MoveToRegion", "--policy", run)[1]
    again = magical_mj.evaluate(run, out=tmp_path / "scores", resume=True, tasks="MoveToRegion", variants="Demo",
                                episodes=2, jobs=1)  # fmt: skip
    assert set(again["preset"]) == {"State"}
    both = magical_mj.evaluate({"run": run, "noop": "noop"}, **SMALL)
    assert both[both["policy"] == "run"]["preset"].eq("State").all()
    with pytest.raises(SettingsError, match="needs the preset State, not LoRes4E: give --preset State"):
        magical_mj.evaluate({"run": run, "function": lambda _: 0}, **SMALL)
    with pytest.raises(SettingsError, match="give --preset State"):
        magical_mj.evaluate(run, preset="LoRes4E", **SMALL)


def test_a_policy_that_fails_is_told_what_it_was_given() -> None:
    def act(observation: Any) -> int:
        return observation["ego"]

    for preset, said in (
        ("LoRes4E", r"it was given LoRes4E \(96, 96, 12\)"),
        ("LoResStack", r"it was given LoResStack, a dict of allo \(96, 96, 12\), ego \(96, 96, 12\)"),
    ):
        with pytest.raises(EvaluationError, match=said):
            magical_mj.evaluate(act, preset=preset, **SMALL)


def test_a_policy_may_begin_by_reset_batch_and_act_alone() -> None:
    class Counting:
        started = 0

        def reset_batch(self, episodes: list[magical_mj.evaluation.Episode]) -> None:
            self.started += len(episodes)

        def __call__(self, observation: object) -> int:
            return 0

    policy = Counting()
    magical_mj.evaluate(policy, tasks="MoveToRegion", variants="Demo", episodes=2)
    assert policy.started == 2


def test_what_a_policy_learnt_from_has_its_own_type() -> None:
    class Declares:
        learnt: Any = "demonstration_set=2"

        def __call__(self, observation: object) -> int:
            return 0

    with pytest.raises(SettingsError, match=r"Learnt\(demonstration_set=2\)"):
        magical_mj.evaluate(Declares(), tasks="MoveToRegion", variants="Demo", episodes=1)


def test_errors_list_the_kinds_of_policies() -> None:
    with pytest.raises(UnknownNameError, match=r"module:object, FILE.zip, FILE.onnx, a run's folder"):
        magical_mj.evaluate("somebody", **SMALL)
    with pytest.raises(SettingsError, match=r"or a run's folder"):
        magical_mj.evaluate(7, **SMALL)


ONNX = """
import sys
from importlib.abc import MetaPathFinder
from pathlib import Path
class Absent(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("onnxscript", "torch"):
            raise ModuleNotFoundError(name)
sys.meta_path.insert(0, Absent())
import magical_mj
played = magical_mj.evaluate("model.onnx", tasks="MoveToRegion", variants="Demo", episodes=1, jobs=1)
assert played["failure"].isna().all() and set(played["preset"]) == {"State"}
"""


def write_onnx(path: Path, shape: list[Any], outputs: list[Any]) -> None:
    """A network whose values are the first 18 of what it sees."""
    onnx = pytest.importorskip("onnx")
    helper, kind = onnx.helper, onnx.TensorProto.FLOAT
    axis = onnx.numpy_helper.from_array(np.array([len(shape) - 1]), "axis")
    ends = [onnx.numpy_helper.from_array(np.array([value]), name) for name, value in (("first", 0), ("end", 18))]
    graph = helper.make_graph(
        [helper.make_node("Slice", ["seen", "first", "end", "axis"], ["values"])],
        "slice",
        [helper.make_tensor_value_info("seen", kind, shape)],
        [helper.make_tensor_value_info("values", kind, outputs)],
        [axis, *ends],
    )
    onnx.save(helper.make_model(graph, ir_version=10, opset_imports=[helper.make_opsetid("", 18)]), path)


def test_onnx_files_need_onnx_runtime_alone_and_write_nothing_at_home(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    home = tmp_path / "home"
    home.mkdir()
    size = len(magical_mj.observations.STATE_NAMES)
    write_onnx(tmp_path / "model.onnx", ["n", size], ["n", 18])
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("ORT_", "XDG_"))}
    subprocess.run([sys.executable, "-c", ONNX], cwd=tmp_path, env=kept | {"HOME": str(home)}, check=True)
    assert [str(path) for path in home.rglob("*") if path.is_file() and "matplotlib" not in str(path)] == []


def test_onnx_runtime_is_imported_in_one_place_that_turns_its_telemetry_off() -> None:
    folders = ("magical_mj", "methods", "examples", "site", "tests", "tools")
    importing = [
        str(path.relative_to(ROOT))
        for folder in folders
        for path in (ROOT / folder).rglob("*.py")
        if re.search(r"^\s*(import|from) onnxruntime", path.read_text("utf-8"), re.MULTILINE)
    ]
    assert importing == ["magical_mj/policies/models.py"]


def test_an_onnx_input_needs_a_batch_axis(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    size = len(magical_mj.observations.STATE_NAMES)
    env: Any = gymnasium.make(STATE)
    observation, _ = env.reset(seed=3)
    for number, shape in enumerate(([size], ["names"], [96, 96, 12], [4, size])):
        write_onnx(tmp_path / f"{number}.onnx", shape, [None] * len(shape))
        with pytest.raises(SettingsError, match="first axis must be a batch of any size: export it with"):
            magical_mj.evaluate(tmp_path / f"{number}.onnx", preset="State", **SMALL)
    write_onnx(tmp_path / "one.onnx", [1, size], [1, 18])  # as exports without dynamic shapes are
    write_onnx(tmp_path / "any.onnx", ["n", size], ["n", 18])
    one, several = load_onnx(tmp_path / "one.onnx"), load_onnx(tmp_path / "any.onnx")
    rows = np.stack([observation, observation[::-1]])
    wanted = rows[:, :18].argmax(axis=1).tolist()
    assert one.act_batch(rows).tolist() == several.act_batch(rows).tolist() == wanted
