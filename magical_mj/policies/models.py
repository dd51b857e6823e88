"""Trained models from files: stable-baselines3 archives and ONNX.

Files may be somebody else's: what is read is bounded, by declared and by actual size, and so are networks.

A stable-baselines3 archive contains pickles, and reading a pickle runs whatever code it contains. So none is read
unless the user sets ``trust``: standard actor-critic networks (PPO, A2C and similar) are rebuilt from the archive's
plain JSON, and their weights are loaded as plain tensors. ONNX files contain no Python code. (TorchScript is not
supported: its files are programs too, and PyTorch has deprecated it.)
"""

from __future__ import annotations

import io
import json
import math
import os
import warnings
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from magical_mj.policies.interface import HISTORY, Episode, History, reason
from magical_mj.scene.actions import ACTIONS
from magical_mj.scene.state_vector import STATE_NAMES
from magical_mj.utils.errors import MissingExtraError, SettingsError

OTHER_ACTIONS: Final = (
    f"each action is one of the numbers 0 to {len(ACTIONS) - 1}; around a model with continuous actions, give a "
    "function that ends in magical_mj.scene.actions.to_discrete (docs/evaluation.md)"
)
MOST_OF_POLICY: Final = 1_000_000_000
"""The largest content of a model's file that is read."""
MOST_SETTINGS: Final = 100_000_000
"""The largest settings in a stable-baselines3 archive that are read; they hold the last observations, too."""
MOST_PARAMETERS: Final = 100_000_000
"""The largest number of parameters of a network that is rebuilt; those of the paper have 2 million."""
MOST_OBSERVED: Final = 10_000_000
"""The largest number of values in an observation of such a network."""
MOST_MEMORY: Final = 2_000_000_000
"""The largest number of bytes that all ONNX networks of a process may take, weights and values in between."""
FOLDED: Final = "10000000"
"""The largest number of bytes of a value that ONNX Runtime computes when it loads a network, outside that bound."""
LONGEST_ARGUMENTS: Final = 10_000
"""The greatest length of what says how such a network is built."""
Shape = tuple[int | None, ...]
"""The shape of an observation; None stands for any size."""

TRUST: Final = "--trust (trust=True) loads it and runs the code that it contains: do that only with files of your own"


class Model:
    """A policy that maps a batch of observations to a batch of actions.

    Args:
        act: the mapping.
        shapes: the accepted shapes of single observations; None if unknown.
        remembers: whether it maps `History.states` instead, and observations are states.

    Attributes:
        tasks: on which it was trained, and
        preset: the preset of the observations, where the file says so.
    """

    tasks: tuple[str, ...]
    preset: str

    def __init__(
        self, act: Callable[[Any], Any], shapes: Sequence[Shape] | None = None, *, remembers: bool = False
    ) -> None:
        self._act, self._remembers = act, remembers
        self._history: History | None = None
        self.observation_shapes = shapes

    def reset_batch(self, episodes: Sequence[Episode]) -> None:
        """Episodes begin, side by side."""
        del episodes
        self._history = None

    def reset(self, episode: Episode) -> None:
        """An episode begins."""
        self.reset_batch([episode])

    def act_batch(self, observations: Any) -> Any:
        """An action for each observation. Shape (n,)."""
        if self._remembers:
            self._history = self._history or History(observations)
            observations = self._history.add(observations)
        return self._act(observations)

    def __call__(self, observation: Any) -> Any:
        """The action for one observation."""
        if isinstance(observation, dict):
            return self.act_batch({name: value[None] for name, value in observation.items()})[0]
        return self.act_batch(observation[None])[0]


@contextmanager
def torch_settings(threads: int | None = None) -> Iterator[None]:
    """A context in which PyTorch computes as it does unless its user has set something: float32, gradients, exactly.

    Policies act on one of its threads: sums depend on how they are split, and workers share the cores. None: as before.
    """
    import torch

    before = torch.get_num_threads(), torch.get_default_dtype(), torch.get_float32_matmul_precision()
    with ExitStack() as stack:
        stack.enter_context(torch.inference_mode(False))
        stack.enter_context(torch.enable_grad())
        for device in filter(torch.is_autocast_enabled, ("cpu", "cuda")):
            stack.enter_context(torch.autocast(device, enabled=False))
        if torch.empty(0).device.type != "cpu":  # as is made by default
            stack.enter_context(torch.device("cpu"))
        try:
            _set_torch(threads or before[0], torch.float32, "highest")
            yield
        finally:
            _set_torch(*before)


def _set_torch(threads: int, kind: Any, precision: str) -> None:
    import torch

    torch.set_num_threads(threads)
    torch.set_default_dtype(kind)
    torch.set_float32_matmul_precision(precision)


def load_sb3(path: Path, trust: bool = False) -> Model:
    """The policy of a stable-baselines3 archive; it acts deterministically."""
    try:
        import stable_baselines3  # noqa: F401  (which needs PyTorch)
    except ModuleNotFoundError:
        raise MissingExtraError(f"{path} needs stable-baselines3: pip install stable-baselines3") from None
    data, weights = _content(path)
    with _refused(f"{path} does not say how its network is built"), torch_settings():
        policy = _trusted(path) if trust else _rebuilt(path, data, weights)
    if not isinstance(policy.action_space, spaces.Discrete) or policy.action_space.n != len(ACTIONS):
        raise SettingsError(f"{path} acts in {policy.action_space}, and {OTHER_ACTIONS}")
    try:
        policy.load_state_dict(weights)
    except RuntimeError as error:
        raise SettingsError(f"{path} is not of a standard network; {TRUST}") from error
    policy.set_training_mode(False)
    return Model(lambda observations: _best_actions(policy, observations), _accepted(policy.observation_space))


def _content(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """The JSON and the weights of a stable-baselines3 archive."""
    import torch

    with _refused(f"{path} is not a stable-baselines3 archive"), zipfile.ZipFile(path) as archive:
        data = _named(json.loads(_member(path, archive, "data", MOST_SETTINGS)))
        packed = _member(path, archive, "policy.pth", MOST_OF_POLICY)
    try:
        _check_packed(path, packed)
        with warnings.catch_warnings(action="ignore"):  # of pickles that are refused
            weights = _named(torch.load(io.BytesIO(packed), map_location="cpu", weights_only=True))
    except SettingsError:
        raise
    except Exception as error:  # whose message advises to load pickles
        raise SettingsError(f"{path} has weights that are not tensors; it is not loaded") from error
    return data, weights


@contextmanager
def _refused(fault: str) -> Iterator[None]:
    """Makes any error a `SettingsError` that begins with the fault; reading a damaged file may raise anything."""
    try:
        yield
    except SettingsError:
        raise
    except Exception as error:
        raise SettingsError(f"{fault}: {reason(error)}") from error


def _member(path: Path, archive: zipfile.ZipFile, name: str, most: int) -> bytes:
    """A member of an archive; raises a `SettingsError` if it is larger than `most` bytes."""
    with archive.open(name) as file:
        content = b"" if archive.getinfo(name).file_size > most else file.read(most + 1)
    if archive.getinfo(name).file_size > most or len(content) > most:
        raise SettingsError(f"{path} holds {name} of more than {most:,} bytes, and is not read")
    return content


def _check_packed(path: Path, packed: bytes) -> None:
    """Checks PyTorch's file of weights, which is an archive, too, before PyTorch unpacks it."""
    with zipfile.ZipFile(io.BytesIO(packed)) as inner:
        if sum(member.file_size for member in inner.infolist()) > MOST_OF_POLICY:
            raise SettingsError(f"{path} holds weights of more than {MOST_OF_POLICY:,} bytes, and is not read")
        pickles = [member.filename for member in inner.infolist() if member.filename.endswith(".pkl")]
        if any(b"bytearray" in inner.read(name) for name in pickles):  # PyTorch would make one of any size
            raise ValueError("bytes where tensors should be")


def _named(values: Any) -> dict[str, Any]:
    if not isinstance(values, dict):
        raise TypeError(f"a {type(values).__name__} where names and values should be")
    return values


def _best_actions(policy: Any, observations: Any) -> Any:
    """Shape (n,)."""
    import torch

    if not hasattr(policy, "get_distribution"):
        with torch_settings(1):
            return policy.predict(observations, deterministic=True)[0]

    with torch_settings(1), torch.no_grad():
        chosen = policy.get_distribution(policy.obs_to_tensor(observations)[0])
        _check_numbers(chosen.distribution.logits.cpu().numpy())
        return chosen.get_actions(deterministic=True).cpu().numpy()


def _check_numbers(values: NDArray[Any]) -> None:
    if np.isnan(values).any():
        raise ValueError("the network's output is not a number (NaN)")


def _accepted(space: spaces.Space[Any]) -> list[Shape] | None:
    """The shapes of observations that a stable-baselines3 policy accepts; it transposes pictures itself."""
    shape = space.shape
    if shape is None:  # of a dict
        return None
    return [shape, (*shape[1:], shape[0]), (shape[-1], *shape[:-1])] if len(shape) == 3 else [shape]


def _rebuilt(path: Path, data: dict[str, Any], weights: dict[str, Any]) -> Any:
    """A standard actor-critic network, rebuilt from the archive's plain JSON."""
    import torch
    from stable_baselines3.common.policies import ActorCriticCnnPolicy, ActorCriticPolicy

    arguments: Any = data.get("policy_kwargs")
    observed, acted = data.get("observation_space", {}), data.get("action_space", {})
    plain = isinstance(arguments, dict) and ":serialized:" not in arguments
    if not plain or "action_net.weight" not in weights or not observed.get("_shape"):
        raise SettingsError(f"{path} keeps how its network is built as a pickle; {TRUST}")
    if "n" not in acted or int(acted["n"]) != len(ACTIONS):
        raise SettingsError(f"{path} was trained with other actions, and {OTHER_ACTIONS}")
    shape, pictures = tuple(int(n) for n in _plain(observed["_shape"])), observed.get("dtype") == "uint8"
    if math.prod(shape) > MOST_OBSERVED or len(str(arguments)) > LONGEST_ARGUMENTS:
        raise SettingsError(
            f"{path} looks at more than {MOST_OBSERVED:,} values at a time, or describes its network by more than "
            f"{LONGEST_ARGUMENTS:,} characters, and is not loaded"
        )
    space = spaces.Box(0, 255, shape, np.uint8) if pictures else spaces.Box(-np.inf, np.inf, shape, np.float32)
    convolutional = any(name.startswith("features_extractor.cnn") for name in weights)
    kind = ActorCriticCnnPolicy if convolutional else ActorCriticPolicy
    outline = type("Outline", (kind,), {"device": property(lambda _: torch.device("meta"))})
    with torch.device("meta"):  # where parameters have shapes, and take no memory
        planned = outline(space, spaces.Discrete(len(ACTIONS)), lambda _: 0.0, **arguments).state_dict()
    if sum(parameter.numel() for parameter in planned.values()) > MOST_PARAMETERS:
        raise SettingsError(f"{path} has a network of more than {MOST_PARAMETERS:,} parameters, and is not loaded")
    return kind(space, spaces.Discrete(len(ACTIONS)), lambda _: 0.0, **arguments)


def _plain(value: Any) -> Any:
    return json.loads(value.replace("(", "[").replace(",)", "]").replace(")", "]")) if isinstance(value, str) else value


def _trusted(path: Path) -> Any:
    """Any network, loaded with the archive's pickles."""
    from stable_baselines3.common.save_util import load_from_zip_file

    data: Any = load_from_zip_file(path, device="cpu")[0] or {}
    arguments = data.get("policy_kwargs") or {}
    return data["policy_class"](data["observation_space"], data["action_space"], lambda _: 0.0, **arguments)


def load_onnx(path: Path, trust: bool = False) -> Model:
    """An ONNX network that outputs actions, or a value for each action, of which the best is taken."""
    del trust  # ONNX files contain no code
    if find_spec("onnxruntime") is None:
        raise MissingExtraError(f"{path} needs ONNX Runtime: pip install onnxruntime")
    onnxruntime = onnx_runtime()
    if path.stat().st_size > MOST_OF_POLICY:
        raise SettingsError(f"{path} has more than {MOST_OF_POLICY:,} bytes, and is not read")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4  # errors are raised, too
    _bound_memory()
    options.add_session_config_entry("session.use_env_allocators", "1")
    options.add_session_config_entry("optimization.constant_folding_max_output_size_in_bytes", FOLDED)
    with _refused(f"{path} is not an ONNX file that can be run"):
        session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    entries, output = session.get_inputs(), session.get_outputs()[0]
    if len(entries) != 1:
        raise SettingsError(f"{path} wants {len(entries)} inputs, and presets give one array: choose its preset")
    entry = entries[0]
    most = entry.shape[0] if len(entry.shape) > 1 else 0  # a name, or None, where the batch may have any size
    if isinstance(most, int) and most != 1:
        raise SettingsError(
            f"{path} has an input of shape {entry.shape}, whose first axis should be a batch of any size: export it "
            'with torch.onnx.export(..., dynamic_shapes=({0: "batch"},)), as in docs/evaluation.md'
        )
    if len(output.shape) == 2 and isinstance(output.shape[1], int) and output.shape[1] not in (1, len(ACTIONS)):
        raise SettingsError(f"{path} gives {output.shape[1]} values, and there are {len(ACTIONS)} actions")
    kinds = {"tensor(uint8)": np.uint8, "tensor(float)": np.float32, "tensor(double)": np.float64}
    kind = kinds.get(entry.type, np.float32)

    def act(observations: Any) -> Any:
        try:
            rows = np.asarray(observations, kind)
            batches = rows[:, None] if most == 1 else [rows]
            values = np.concatenate([session.run([output.name], {entry.name: batch})[0] for batch in batches])
        except Exception as error:  # ONNX Runtime's own have no common base
            if "Available memory" not in str(error):
                raise
            raise MemoryError(f"{path} needs more than the {MOST_MEMORY:,} bytes that networks may take") from error
        _check_numbers(values)
        return values.reshape(len(values)) if values.size == len(values) else values.argmax(axis=1)

    shape = tuple(size if isinstance(size, int) else None for size in entry.shape[1:])
    remembers = shape == (HISTORY, len(STATE_NAMES))
    model = Model(act, [shape[1:] if remembers else shape], remembers=remembers)
    known = session.get_modelmeta().custom_metadata_map  # which `export_policy` wrote
    if {"task", "preset"} <= known.keys():
        model.tasks, model.preset = (known["task"],), known["preset"]
    return model


def onnx_runtime() -> Any:
    """The module, imported with its telemetry off, which writes into the user's home."""
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    import onnxruntime

    return onnxruntime


@cache
def _bound_memory() -> None:
    """Has all networks of this process take their memory from one arena, whose size is bounded."""
    onnxruntime = onnx_runtime()
    kind, use = onnxruntime.OrtAllocatorType.ORT_ARENA_ALLOCATOR, onnxruntime.OrtMemType.DEFAULT
    bound = {
        "max_mem": MOST_MEMORY,
        "arena_extend_strategy": 1,  # as much as is needed, and not twice as much each time
        "initial_chunk_size_bytes": -1,
        "max_dead_bytes_per_chunk": -1,
    }
    place = onnxruntime.OrtMemoryInfo("Cpu", kind, 0, use)
    onnxruntime.create_and_register_allocator(place, onnxruntime.OrtArenaCfg(bound))


LOADERS: Final[dict[str, Callable[[Path, bool], Model]]] = {".zip": load_sb3, ".onnx": load_onnx}
"""By the ending of the file's name."""
