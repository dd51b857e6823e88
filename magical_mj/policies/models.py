"""Trained models from files: stable-baselines3 archives and ONNX.

Files may come from an untrusted source. So the sizes of files and networks are limited.

A stable-baselines3 archive contains pickles, and loading a pickle can run any code. So pickles are only loaded if the
user sets ``trust``. Without it, stable-baselines3's own MlpPolicy and CnnPolicy (of PPO, A2C, TRPO and DQN), also with
other layers and with one of `ACTIVATIONS`, are rebuilt from the archive's plain JSON, and their weights are loaded as
plain tensors. Its MultiInputPolicy needs trust, since the archive describes dicts in a pickle.

ONNX files contain no Python code. TorchScript is not supported: its files contain programs as well, and PyTorch has
deprecated it.
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

from magical_mj.actions import ACTIONS
from magical_mj.observations import STATE_NAMES
from magical_mj.policies.facts import Learnt, from_texts
from magical_mj.policies.interface import HISTORY, Episode, History, batch_of_one, reason
from magical_mj.policies.onnx_files import check_onnx
from magical_mj.utils.environment import environment_restored
from magical_mj.utils.errors import MissingExtraError, SettingsError

OTHER_ACTIONS: Final = (
    f"an action must be an integer from 0 to {len(ACTIONS) - 1}; to evaluate a model with continuous actions, give a "
    "function that converts them with magical_mj.actions.to_discrete (docs/policies.md)"
)
MOST_OF_POLICY: Final = 1_000_000_000
"""The maximum size of a model's file, in bytes; also of its weights after unpacking."""
MOST_SETTINGS: Final = 100_000_000
"""The maximum size of the settings in a stable-baselines3 archive, in bytes. They include the last observations."""
MOST_PARAMETERS: Final = 100_000_000
"""The maximum number of parameters of a rebuilt network. The paper's networks have 2 million."""
MOST_OBSERVED: Final = 10_000_000
"""The maximum number of values in an observation of a rebuilt network."""
MOST_MEMORY: Final = 2_000_000_000
"""The maximum number of bytes that all ONNX networks of a process may allocate for weights and activations."""
FOLDED: Final = "10000000"
"""The maximum number of bytes of a constant that ONNX Runtime folds while loading. `MOST_MEMORY` does not limit it."""
ONNX_TYPES: Final = {"tensor(uint8)": np.uint8, "tensor(float)": np.float32, "tensor(double)": np.float64}
"""The accepted types of the inputs of ONNX networks."""
LONGEST_ARGUMENTS: Final = 10_000
"""The maximum length of the text of a rebuilt network's constructor arguments."""
ACTIVATIONS: Final = ("ELU", "GELU", "LeakyReLU", "Mish", "ReLU", "SELU", "SiLU", "Tanh")
"""The activation functions (`torch.nn`) of networks that are rebuilt without trust."""
AUTHORS: Final = ("stable_baselines3.", "sb3_contrib.")
"""The beginnings of the names of modules whose networks are rebuilt without trust."""
OPTIMIZER: Final = ("optimizer_class", "optimizer_kwargs")
"""The arguments of a network's constructor that do not change how it acts."""
Shape = tuple[int | None, ...]
"""The shape of an observation. None means any size."""

TRUST: Final = "--trust (trust=True) loads it and runs the code that it contains: use it only for files that you trust"


class Model:
    """A policy that maps a batch of observations to a batch of actions.

    Args:
        act: the mapping.
        shapes: the accepted shapes of single observations. None if unknown.
        remembers: whether observations are state vectors, and `act` takes the last few of them (`History.states`).

    Attributes:
        tasks, preset, learnt: facts about its training. Missing if the file lacks them.
    """

    tasks: tuple[str, ...]
    preset: str
    learnt: Learnt

    def __init__(
        self, act: Callable[[Any], Any], shapes: Sequence[Shape] | None = None, *, remembers: bool = False
    ) -> None:
        self._act, self._remembers = act, remembers
        self._history: History | None = None
        self.observation_shapes = shapes

    def reset_batch(self, episodes: Sequence[Episode]) -> None:
        """Starts a batch of episodes."""
        del episodes
        self._history = None

    def reset(self, episode: Episode) -> None:
        """Starts an episode."""
        self.reset_batch([episode])

    def act_batch(self, observations: Any) -> Any:
        """An action for each observation. Shape (n,)."""
        if self._remembers:
            self._history = self._history or History(observations)
            observations = self._history.add(observations)
        return self._act(observations)

    def __call__(self, observation: Any) -> Any:
        """The action for one observation."""
        return self.act_batch(batch_of_one(observation))[0]


class _Predicting(Model):
    """A policy of stable-baselines3 without a distribution of actions, or with its own `predict`.

    `predict` gets the state that it returned before, such as that of a recurrent network. At the start of an episode,
    it gets None.
    """

    def __init__(self, policy: Any) -> None:
        super().__init__(self._predicted, _accepted(policy.observation_space))
        self._policy, self._state = policy, None

    def reset_batch(self, episodes: Sequence[Episode]) -> None:
        """Starts a batch of episodes."""
        super().reset_batch(episodes)
        self._state = None

    def _predicted(self, observations: Any) -> Any:
        with torch_settings(1):
            actions, self._state = self._policy.predict(observations, self._state, deterministic=True)
        return actions


@contextmanager
def torch_settings(threads: int | None = None) -> Iterator[None]:
    """A context with PyTorch's default settings: float32, gradients, the highest precision, the CPU.

    Policies act on one thread, because sums depend on the number of threads, and workers share the cores. With None,
    for code that makes networks, the number of threads is not changed, and the state of PyTorch's global random
    generator is restored at the end.
    """
    import torch

    before = torch.get_num_threads(), torch.get_default_dtype(), torch.get_float32_matmul_precision()
    with ExitStack() as stack:
        stack.enter_context(torch.inference_mode(False))
        stack.enter_context(torch.enable_grad())
        for device in filter(torch.is_autocast_enabled, ("cpu", "cuda")):
            stack.enter_context(torch.autocast(device, enabled=False))
        if torch.empty(0).device.type != "cpu":
            stack.enter_context(torch.device("cpu"))
        if threads is None:
            stack.enter_context(torch.random.fork_rng(devices=[]))
        stack.callback(_set_torch, *before)
        _set_torch(threads or before[0], torch.float32, "highest")
        yield


def _set_torch(threads: int, kind: Any, precision: str) -> None:
    import torch

    torch.set_num_threads(threads)
    torch.set_default_dtype(kind)
    torch.set_float32_matmul_precision(precision)


def load_sb3(path: Path, trust: bool = False) -> Model:
    """The policy of a stable-baselines3 archive. It acts deterministically."""
    try:
        from stable_baselines3.common.policies import BasePolicy  # imports PyTorch
    except ModuleNotFoundError:
        raise MissingExtraError(f"{path} needs stable-baselines3: pip install stable-baselines3") from None
    data, weights = _content(path)
    with _refused(f"{path} does not describe its network"), torch_settings():
        policy = _trusted(path) if trust else _rebuilt(path, data, weights)
    if not isinstance(policy.action_space, spaces.Discrete) or policy.action_space.n != len(ACTIONS):
        raise SettingsError(f"{path} has the action space {policy.action_space}, but {OTHER_ACTIONS}")
    try:
        policy.load_state_dict(weights)
    except RuntimeError as error:
        raise SettingsError(f"{path} does not contain a standard network; {TRUST}") from error
    policy.set_training_mode(False)
    if not hasattr(policy, "get_distribution") or type(policy).predict is not BasePolicy.predict:
        if any(bool(values.isnan().any()) for values in weights.values()):
            raise SettingsError(f"{path} has weights that are not numbers (NaN)")
        return _Predicting(policy)
    return Model(lambda observations: _best_actions(policy, observations), _accepted(policy.observation_space))


def _content(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """The JSON and the weights of a stable-baselines3 archive."""
    import torch

    with _refused(f"{path} is not a stable-baselines3 archive"), zipfile.ZipFile(path) as archive:
        data = _named(json.loads(_member(path, archive, "data", MOST_SETTINGS)))
        packed = _member(path, archive, "policy.pth", MOST_OF_POLICY)
    try:
        _check_packed(path, packed)
        with warnings.catch_warnings(action="ignore"):  # about rejected pickles
            weights = _named(torch.load(io.BytesIO(packed), map_location="cpu", weights_only=True))
    except SettingsError:
        raise
    except Exception as error:  # PyTorch's message would recommend loading pickles
        raise SettingsError(f"{path} has weights that are not tensors; it is not loaded") from error
    return data, weights


@contextmanager
def _refused(fault: str) -> Iterator[None]:
    """A context that turns any error into a `SettingsError`. Reading a damaged file may raise any error."""
    try:
        yield
    except SettingsError:
        raise
    except Exception as error:
        raise SettingsError(f"{fault}: {reason(error)}") from error


def _member(path: Path, archive: zipfile.ZipFile, name: str, most: int) -> bytes:
    """A member of an archive. Raises a `SettingsError` if it is larger than `most` bytes."""
    with archive.open(name) as file:
        content = b"" if archive.getinfo(name).file_size > most else file.read(most + 1)
    if archive.getinfo(name).file_size > most or len(content) > most:
        raise SettingsError(f"{path} is not read: its {name} has more than {most:,} bytes")
    return content


def _check_packed(path: Path, packed: bytes) -> None:
    """Checks PyTorch's file of weights, which is a zip archive, before PyTorch unpacks it."""
    with zipfile.ZipFile(io.BytesIO(packed)) as inner:
        if sum(member.file_size for member in inner.infolist()) > MOST_OF_POLICY:
            raise SettingsError(f"{path} is not read: its weights have more than {MOST_OF_POLICY:,} bytes")
        pickles = [member.filename for member in inner.infolist() if member.filename.endswith(".pkl")]
        if any(b"bytearray" in inner.read(name) for name in pickles):  # PyTorch would allocate any requested size
            raise ValueError("the weights contain a bytearray")


def _named(values: Any) -> dict[str, Any]:
    if not isinstance(values, dict):
        raise TypeError(f"expected a dict, not {type(values).__name__}")
    return values


def _best_actions(policy: Any, observations: Any) -> Any:
    """The policy's deterministic actions. Shape (n,)."""
    import torch

    with torch_settings(1), torch.no_grad():
        chosen = policy.get_distribution(policy.obs_to_tensor(observations)[0])
        _check_numbers(chosen.distribution.logits.cpu().numpy())
        return chosen.get_actions(deterministic=True).cpu().numpy()


def _check_numbers(values: NDArray[Any]) -> None:
    if np.isnan(values).any():
        raise ValueError("the network's output is not a number (NaN)")


def _accepted(space: spaces.Space[Any]) -> list[Shape] | None:
    """The observation shapes that a stable-baselines3 policy accepts. It also accepts transposed pictures."""
    shape = space.shape
    if shape is None:  # a dict
        return None
    return [shape, (*shape[1:], shape[0]), (shape[-1], *shape[:-1])] if len(shape) == 3 else [shape]


def _rebuilt(path: Path, data: dict[str, Any], weights: dict[str, Any]) -> Any:
    """A standard network, rebuilt from the archive's plain JSON."""
    import torch
    from stable_baselines3.common.policies import ActorCriticCnnPolicy, ActorCriticPolicy
    from stable_baselines3.dqn.policies import CnnPolicy, DQNPolicy

    standard = {
        ("action_net.weight", False): ActorCriticPolicy,
        ("action_net.weight", True): ActorCriticCnnPolicy,
        ("q_net.q_net.0.weight", False): DQNPolicy,
        ("q_net.q_net.0.weight", True): CnnPolicy,
    }
    convolutional = any("features_extractor.cnn." in name for name in weights)
    kind = next((kind for (name, cnn), kind in standard.items() if name in weights and cnn == convolutional), None)
    arguments = _arguments(data)
    observed, acted = data.get("observation_space", {}), data.get("action_space", {})
    if kind is None or arguments is None or not observed.get("_shape"):
        raise SettingsError(f"{path} describes its network in a pickle; {TRUST}")
    if "n" not in acted or int(acted["n"]) != len(ACTIONS):
        raise SettingsError(f"{path} was trained with other actions, but {OTHER_ACTIONS}")
    shape, pictures = tuple(int(n) for n in _plain(observed["_shape"])), observed.get("dtype") == "uint8"
    if math.prod(shape) > MOST_OBSERVED or len(str(arguments)) > LONGEST_ARGUMENTS:
        raise SettingsError(
            f"{path} is not loaded: its observations have more than {MOST_OBSERVED:,} values, or its policy_kwargs "
            f"have more than {LONGEST_ARGUMENTS:,} characters"
        )
    space = spaces.Box(0, 255, shape, np.uint8) if pictures else spaces.Box(-np.inf, np.inf, shape, np.float32)
    outline = type("Outline", (kind,), {"device": property(lambda _: torch.device("meta"))})
    try:
        with torch.device("meta"):  # to count the parameters without allocating memory
            planned = outline(space, spaces.Discrete(len(ACTIONS)), lambda _: 0.0, **arguments).state_dict()
    except TypeError as error:
        raise SettingsError(f"{path} does not contain a standard network ({error}); {TRUST}") from error
    if sum(parameter.numel() for parameter in planned.values()) > MOST_PARAMETERS:
        raise SettingsError(f"{path} is not loaded: its network has more than {MOST_PARAMETERS:,} parameters")
    return kind(space, spaces.Discrete(len(ACTIONS)), lambda _: 0.0, **arguments)


def _arguments(data: dict[str, Any]) -> dict[str, Any] | None:
    """The arguments of a network's constructor. None if only the archive's pickles contain them, or the class.

    If a value is not plain JSON, its text is stored next to the pickle of all arguments.
    """
    import torch

    described, kind = data.get("policy_kwargs"), data.get("policy_class")
    module = kind.get("__module__", AUTHORS[0]) if isinstance(kind, dict) else AUTHORS[0]
    if not isinstance(described, dict) or not str(module).startswith(AUTHORS):
        return None
    activations = {str(getattr(torch.nn, name)): getattr(torch.nn, name) for name in ACTIVATIONS}
    arguments = {name: value for name, value in described.items() if name[0] != ":" and name not in OPTIMIZER}
    if described.get("activation_fn") in activations:
        arguments["activation_fn"] = activations[described["activation_fn"]]
    return None if any(isinstance(value, str) for value in arguments.values()) else arguments


def _plain(value: Any) -> Any:
    """A shape from an archive's JSON, as a list. It may be the text of a tuple, such as "(3, 96, 96)" or "(8,)"."""
    if not isinstance(value, str):
        return value
    return json.loads(value.replace("(", "[").replace(",)", "]").replace(")", "]"))


def _trusted(path: Path) -> Any:
    """Any network, loaded from the archive's pickles."""
    from stable_baselines3.common.save_util import load_from_zip_file

    data: Any = load_from_zip_file(path, device="cpu")[0] or {}
    arguments = data.get("policy_kwargs") or {}
    return data["policy_class"](data["observation_space"], data["action_space"], lambda _: 0.0, **arguments)


def load_onnx(path: Path, trust: bool = False) -> Model:
    """An ONNX network that outputs actions, or a value for each action. The action with the largest value is taken.

    `trust`: it may have loops, which need not end.
    """
    if find_spec("onnxruntime") is None:
        raise MissingExtraError(f"{path} needs ONNX Runtime: pip install onnxruntime")
    onnxruntime = onnx_runtime()
    if path.stat().st_size > MOST_OF_POLICY:
        raise SettingsError(f"{path} is not read: it has more than {MOST_OF_POLICY:,} bytes")
    check_onnx(path, MOST_OF_POLICY, trust)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4  # no log of errors, since they are raised as well
    _bound_memory()
    options.add_session_config_entry("session.use_env_allocators", "1")
    options.add_session_config_entry("optimization.constant_folding_max_output_size_in_bytes", FOLDED)
    with _refused(f"{path} is not a valid ONNX file"):
        session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    entry, output = _only_input(path, session.get_inputs()), session.get_outputs()[0]
    if len(output.shape) == 2 and isinstance(output.shape[1], int):
        _check_output(path, output.shape[1:])
    most = entry.shape[0] if len(entry.shape) > 1 else 0  # a name or None if the batch may have any size
    kind = ONNX_TYPES[entry.type]

    def act(observations: Any) -> Any:
        try:
            rows = np.asarray(observations, kind)
            batches = rows[:, None] if most == 1 else [rows]
            values = np.concatenate([session.run([output.name], {entry.name: batch})[0] for batch in batches])
        except Exception as error:  # ONNX Runtime's errors have no common base class
            if "Available memory" not in str(error):
                raise
            raise MemoryError(f"{path} needs more than the {MOST_MEMORY:,} bytes that networks may use") from error
        _check_numbers(values)
        _check_output(path, values.shape[1:])  # often not known before
        return values.reshape(len(values)) if values.size == len(values) else values.argmax(axis=1)

    shape = tuple(size if isinstance(size, int) else None for size in entry.shape[1:])
    remembers = shape == (HISTORY, len(STATE_NAMES))
    model = Model(act, [shape[1:] if remembers else shape], remembers=remembers)
    known = session.get_modelmeta().custom_metadata_map  # written by `export_policy`
    if {"task", "preset"} <= known.keys():
        model.tasks, model.preset, model.learnt = (known["task"],), known["preset"], from_texts(known, path)
    return model


def _only_input(path: Path, entries: Sequence[Any]) -> Any:
    """The input of an ONNX file. Raises a `SettingsError` unless it is the only one, for batches of observations."""
    if len(entries) != 1:
        raise SettingsError(
            f"{path} has {len(entries)} inputs, but observations are one array: export it with one input"
        )
    entry = entries[0]
    most = entry.shape[0] if len(entry.shape) > 1 else 0
    if isinstance(most, int) and most != 1:
        raise SettingsError(
            f"{path} has an input of shape {entry.shape}. The first axis must be a batch of any size: export it "
            'with torch.onnx.export(..., dynamic_shapes=({0: "batch"},)), as in docs/policies.md'
        )
    if entry.type not in ONNX_TYPES:
        raise SettingsError(
            f"{path} has an input of type {entry.type}, but pictures are uint8, and states float32: export it with "
            f"one of {', '.join(ONNX_TYPES)}, for example around a cast"
        )
    return entry


def _check_output(path: Path, shape: Sequence[int]) -> None:
    """Raises a `SettingsError` unless this is the shape of one action, or of a value for each action."""
    if tuple(shape) not in ((), (1,), (len(ACTIONS),)):
        raise SettingsError(
            f"{path} outputs {' x '.join(map(str, shape))} values for an observation, but there are {len(ACTIONS)} "
            "actions: it must output an action, or a value for each"
        )


def onnx_runtime() -> Any:
    """The module `onnxruntime`, without its telemetry, which would write into the user's home folder."""
    with environment_restored("ORT_DISABLE_TELEMETRY"):
        os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")  # it is read at the first import
        import onnxruntime

    return onnxruntime


@cache
def _bound_memory() -> None:
    """Makes all networks of this process allocate memory from one arena of limited size."""
    onnxruntime = onnx_runtime()
    kind, use = onnxruntime.OrtAllocatorType.ORT_ARENA_ALLOCATOR, onnxruntime.OrtMemType.DEFAULT
    bound = {
        "max_mem": MOST_MEMORY,
        "arena_extend_strategy": 1,  # grows by the requested size, instead of doubling
        "initial_chunk_size_bytes": -1,
        "max_dead_bytes_per_chunk": -1,
    }
    memory = onnxruntime.OrtMemoryInfo("Cpu", kind, 0, use)
    onnxruntime.create_and_register_allocator(memory, onnxruntime.OrtArenaCfg(bound))


LOADERS: Final[dict[str, Callable[[Path, bool], Model]]] = {".zip": load_sb3, ".onnx": load_onnx}
"""The function that loads a file with this suffix."""
