"""ONNX files of strangers: the files that they name, and loops without end."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical_mj.policies.models import load_onnx
from magical_mj.utils.errors import SettingsError

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

from onnx import TensorProto, helper  # noqa: E402

SIZE = 3 * 18 * 4


def network(path: Path, location: str) -> None:
    """A linear network from 3 values to 18, with its weights in another file."""
    weights = TensorProto(name="w", data_type=TensorProto.FLOAT, dims=[3, 18], data_location=TensorProto.EXTERNAL)
    for key, value in (("location", location), ("offset", "0"), ("length", str(SIZE))):
        weights.external_data.add(key=key, value=value)
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["o", "w"], ["a"])],
        "g",
        [helper.make_tensor_value_info("o", TensorProto.FLOAT, ["batch", 3])],
        [helper.make_tensor_value_info("a", TensorProto.FLOAT, ["batch", 18])],
        [weights],
    )
    model = helper.make_model(graph, ir_version=9, opset_imports=[helper.make_opsetid("", 18)])
    path.write_bytes(model.SerializeToString())


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with weights, in which a test plays, and others next to it."""
    own = tmp_path / "own"
    (own / "inner").mkdir(parents=True)
    (own / "weights.bin").write_bytes(np.eye(3, 18, dtype=np.float32).tobytes())
    (tmp_path / "outside.bin").write_bytes(bytes(SIZE))
    (own / "link.bin").symlink_to(tmp_path / "outside.bin")
    (own / "folder").symlink_to(tmp_path)
    return own


def test_weights_in_another_file_of_the_same_folder_are_loaded(folder: Path) -> None:
    network(folder / "x.onnx", "weights.bin")
    assert load_onnx(folder / "x.onnx")(np.array([0, 0, 1], np.float32)) == 2


@pytest.mark.parametrize(
    "location",
    ["../outside.bin", "inner/../../outside.bin", "/etc/passwd", "link.bin", "folder/outside.bin", "inner", "gone", ""],
)
def test_weights_outside_of_the_models_folder_are_refused(folder: Path, location: str) -> None:
    network(folder / "x.onnx", location)
    with pytest.raises(SettingsError, match="its folder does not contain"):
        load_onnx(folder / "x.onnx", True)


def test_an_absolute_path_into_the_folder_is_refused_as_well(folder: Path) -> None:
    network(folder / "x.onnx", os.fspath(folder / "weights.bin"))
    with pytest.raises(SettingsError, match="its folder does not contain"):
        load_onnx(folder / "x.onnx")


def test_huge_weights_in_another_file_are_refused_before_they_are_read(folder: Path) -> None:
    with (folder / "huge.bin").open("wb") as file:
        file.truncate(10**11)
    network(folder / "x.onnx", "huge.bin")
    with pytest.raises(SettingsError, match="more than 1,000,000,000 bytes"):
        load_onnx(folder / "x.onnx")


def test_a_loop_which_may_never_end_needs_trust(tmp_path: Path) -> None:
    def info(name: str, kind: int = TensorProto.FLOAT, shape: list[int | str] | None = None) -> Any:
        return helper.make_tensor_value_info(name, kind, shape)

    nodes = [helper.make_node("Identity", ["c"], ["d"]), helper.make_node("Identity", ["x"], ["y"])]
    inputs = [info("i", TensorProto.INT64, []), info("c", TensorProto.BOOL, []), info("x")]
    body = helper.make_graph(nodes, "body", inputs, [info("d", TensorProto.BOOL, []), info("y")])
    for rounds in (3, 2**62):
        constants = [helper.make_tensor("n", TensorProto.INT64, [], [rounds])]
        constants.append(helper.make_tensor("t", TensorProto.BOOL, [], [True]))
        graph = helper.make_graph(
            [helper.make_node("Loop", ["n", "t", "o"], ["a"], body=body)],
            *("g", [info("o", TensorProto.FLOAT, ["batch", 18])], [info("a", TensorProto.FLOAT, ["batch", 18])]),
            constants,
        )
        model = helper.make_model(graph, ir_version=9, opset_imports=[helper.make_opsetid("", 18)])
        (tmp_path / "x.onnx").write_bytes(model.SerializeToString())
        with pytest.raises(SettingsError, match="Loop, which may never end: --trust"):
            load_onnx(tmp_path / "x.onnx")
        if rounds == 3:
            assert load_onnx(tmp_path / "x.onnx", trust=True)(np.eye(18, dtype=np.float32)[5]) == 5


@pytest.mark.parametrize("kind", ["FLOAT16", "BFLOAT16", "INT64"])
def test_observations_of_another_type_are_refused(kind: str, tmp_path: Path) -> None:
    values = helper.make_tensor_value_info("o", getattr(TensorProto, kind), ["batch", 18])
    graph = helper.make_graph([helper.make_node("Identity", ["o"], ["a"])], "g", [values], [values])
    graph.output[0].name = "a"
    model = helper.make_model(graph, ir_version=9, opset_imports=[helper.make_opsetid("", 18)])
    (tmp_path / "x.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(SettingsError, match=rf"tensor\({kind.lower()}\), but .* export it with one of tensor\(uint8\)"):
        load_onnx(tmp_path / "x.onnx")
