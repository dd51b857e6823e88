"""Loads policies from names, references ``module:object``, model files, folders of training runs, and objects."""

from __future__ import annotations

import hashlib
import inspect
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.metadata import EntryPoint
from inspect import ismethod
from pathlib import Path
from typing import Any, Final

import msgspec

from magical_mj.envs.presets import DEFAULT_PRESET, PRESETS, observation_space, preset_named
from magical_mj.policies.facts import UNKNOWN, Learnt, learnt_from
from magical_mj.policies.interface import (
    AGENTS,
    NEUTRAL,
    Act,
    BatchPolicy,
    policy_name,
    policy_task,
    reason,
    uses_of,
)
from magical_mj.policies.models import LOADERS, Shape
from magical_mj.shifts.registry import Effect
from magical_mj.tasks.registry import Pair, task_spec
from magical_mj.utils.errors import MissingFileError, SettingsError, short_repr, unknown_name
from magical_mj.utils.imports import announced, errors_of_user, imported, reference_in_folder, source_digest, source_of

ACCEPTED_POLICIES: Final = (
    f"{', '.join(AGENTS)}, module:object, a file that ends in {' or '.join(LOADERS)}, or a run's folder"
)
WEIGHTS: Final = (".bin", ".ckpt", ".pt", ".pth", ".safetensors")
"""The suffixes of files with the weights of a network."""
_POLICY: Final = re.compile(r"^(?:class|def) (\w*(?:policy|agent))\b", re.IGNORECASE | re.MULTILINE)
"""A line of a module that probably defines a policy."""
SHOWN_TASKS: Final = 8
"""The largest number of tasks that an error names: sets of intents have more."""
_COMMA: Final = re.compile(r"(?<!\\),")
"""A comma that separates policies."""
TORCH: Final = (
    "To evaluate a PyTorch network, give --policy mine:Policy, where mine.py contains a class Policy. Its "
    "__init__(self) loads the network, and its __call__(self, observation) returns an action, such as "
    "int(network(torch.as_tensor(observation)[None]).argmax()). Or export it with torch.onnx.export, and give the file "
    "to --policy. docs/policies.md shows both"
)
FOLDER_GROUP: Final = "magical_mj.policy_folders"
"""The entry-point group of functions that load the policy in a folder.

The name of an entry point is the name of a file in such folders.
"""


@dataclass(frozen=True)
class Source:
    """The origin of one policy to be evaluated. It is small, and picklable unless the origin is the policy itself.

    Attributes:
        name: the method's name in tables.
        run: the number of the run of the method.
        origin: a built-in policy's name, ``module:object``, a file, a folder, or the policy itself.
        trust: whether files that contain code may be loaded.
        digest: the expected hash of the policy's file ("sha256") or module ("code"). Empty without a file, or if the
            hash is not checked.
        batches: whether it acts in batches of observations. Set by `checked`, like the attributes below.
        unnoticed: the effects of shifts that it cannot notice. With "instruction", it does not read the instruction.
        uses: what it uses in episodes, of `magical_mj.policies.interface.USES`.
        learnt: what is known about its training.
        needs_plan: whether it is an expert, which follows the task's plan.
    """

    name: str
    run: int
    origin: Any
    trust: bool = False
    digest: Mapping[str, str] = field(default_factory=dict)
    batches: bool = False
    unnoticed: frozenset[Effect] = frozenset()
    uses: frozenset[str] = frozenset(("observations",))
    learnt: Learnt = UNKNOWN
    needs_plan: bool = False

    def checked(self, policy: Act, preset: str) -> Source:
        """The source with the attributes of its policy, which is played with this preset."""
        uses, unnoticed = uses_of(policy), set[Effect]()
        if "observations" in uses and preset_named(preset).layout == "state":
            unnoticed.add("pictures")
        if "instruction" not in uses:
            unnoticed.add("instruction")
        return replace(
            self,
            digest=self._hash(),
            batches="observations" in uses and isinstance(policy, BatchPolicy),
            unnoticed=frozenset(unnoticed),
            uses=uses,
            needs_plan=getattr(policy, "needs_plan", False),
            learnt=learnt_from(self.origin, policy),
        )

    def load(self) -> Act:
        """The policy.

        Raises:
            SettingsError: if the policy does not exist or is invalid, or its file has changed.
            UnknownNameError, MissingExtraError: if it cannot be imported.
        """
        was_imported = isinstance(self.origin, str) and source_of(self.origin) is not None
        policy = self._load()
        check_policy(policy, self.name if isinstance(self.origin, str) else short_repr(policy))
        if self.digest and not was_imported and self.digest != self._hash():
            raise SettingsError(
                f"{self.origin} was changed while it was evaluated, so that its scores would mix two policies: "
                "evaluate a copy"
            )
        return policy

    def _load(self) -> Act:
        if not isinstance(self.origin, str):
            return self.origin
        if self.origin in AGENTS:
            return AGENTS[self.origin]()
        path = Path(self.origin)
        if not path.exists() and path.suffix in (*LOADERS, *WEIGHTS):
            raise MissingFileError(f"the file {path} does not exist")
        if path.suffix in LOADERS:
            if not path.is_file():
                raise SettingsError(f"{path} is not a plain file: it is a folder, a pipe or a device")
            return LOADERS[path.suffix](path, self.trust)
        if path.is_dir():
            return policy_in(path)
        if ":" in self.origin:
            policy = imported("policy", self.origin, None, SettingsError)
            return _instantiate(policy, self.origin) if inspect.isclass(policy) else policy
        if path.suffix in WEIGHTS:
            raise SettingsError(f"{path} contains the weights of a network, but not its code. {TORCH}")
        if not path.exists() and len(path.parts) > 1:
            raise MissingFileError(f"the file or folder {path} does not exist")
        files = (f"FILE{suffix}" for suffix in LOADERS)
        allowed = (*AGENTS, "module:object", *files, "a run's folder")
        raise unknown_name("policy", self.origin, allowed, reference_in_folder(self.origin, _POLICY))

    def described(self) -> dict[str, Any]:
        """The facts about the policy that must be the same when an evaluation is resumed."""
        origin = self.origin if isinstance(self.origin, str) else f"a Python object: {type(self.origin).__qualname__}"
        known = {**self.digest, **msgspec.to_builtins(self.learnt)}
        facts = {"uses": sorted(self.uses), "loaded": self.loaded}
        return {"name": self.name, "run": self.run, "origin": origin, **known, **facts}

    @property
    def loaded(self) -> str:
        """The kind of origin: built in, an object, code, a folder, or a kind of file, such as onnx."""
        if not isinstance(self.origin, str):
            return "object"
        if self.origin in AGENTS:
            return "built in"
        path = Path(self.origin)
        return path.suffix[1:] if path.suffix in LOADERS else "folder" if path.is_dir() else "code"

    def _hash(self) -> dict[str, str]:
        """The hash of the policy's file or module. Empty without a file."""
        if not isinstance(self.origin, str) or self.origin in AGENTS:
            return {}
        file = Path(self.origin)
        if file.suffix not in LOADERS and file.is_dir():
            file /= _folder_loader(file).name
        elif file.suffix not in LOADERS:
            code = source_digest(self.origin)
            return {"code": code} if code else {}
        return {"sha256": hashlib.sha256(file.read_bytes()).hexdigest()}


def sources(policies: Any, run: int = 0, trust: bool = False) -> list[Source]:
    """The origins of the policies in the argument of `evaluate`. Policies with the same name are runs of one method.

    Args:
        policies: one policy, or a list of them, or a mapping of names to policies or lists. A policy is an object, a
            path, or text: a name, ``module:object``, a file or a folder, optionally as ``NAME=...``.
        run: the number of the first run.
        trust: whether files that contain code may be loaded.

    Raises:
        SettingsError: for any other argument, and for names that cannot be printed.
    """
    listed: list[Source] = []
    runs: Counter[str] = Counter()
    for name, origin in _parse_policies(policies):
        if not isinstance(name, str) or not name.strip() or not name.isprintable():
            raise SettingsError(f"the name of a method must consist of printable characters, not {short_repr(name)}")
        listed.append(Source(name, run + runs[name], origin, trust))
        runs[name] += 1
    if not listed:
        raise SettingsError(f"give a policy: {ACCEPTED_POLICIES}")
    return listed


def common_preset(policies: Iterable[object]) -> str:
    """The preset that all policies were trained with, or `DEFAULT_PRESET`.

    A policy's preset is its attribute `preset`, or the only one that matches its `observation_shapes`.
    """
    known = set[str]()
    for policy in policies:
        if hasattr(policy, "preset") or "observations" in uses_of(policy):
            fitting = _fitting(policy)
            known.add(getattr(policy, "preset", fitting[0] if len(fitting) == 1 else DEFAULT_PRESET))
    return known.pop() if len(known) == 1 else DEFAULT_PRESET


def doubts(source: Source, policy: Act, preset: str, *, is_chosen: bool) -> Iterator[str]:
    """Why the scores of a policy may not be those that the user expects.

    Args:
        source: the policy's origin.
        policy: the policy.
        preset: the preset of its observations.
        is_chosen: whether `common_preset` has chosen the preset.
    """
    others = [name for name in _fitting(policy) if name not in ("", preset)]
    if is_chosen and others and not hasattr(policy, "preset"):
        yield (
            f"{source.name} is played with the preset {preset}, but observations of {', '.join(others)} have the same "
            "shape: if it was trained on those, or to avoid this warning, give --preset (preset=...)"
        )
    if stopped := source.learnt.unfinished:
        yield (
            f"the training of {source.name} in {source.origin} has stopped at {stopped}, and its scores are those "
            "of an unfinished training: magical-mj train --resume finishes it"
        )
    if isinstance(source.origin, str) and source.loaded == "zip":
        path = Path(source.origin)
        found = [*path.parent.glob("*vecnormalize*.pkl"), *path.with_suffix("").glob("*vecnormalize*.pkl")]
        if found:
            yield (
                f"{path} is played without {min(found)}: if it was trained in VecNormalize, its observations lack the "
                "normalization; docs/policies.md shows how to evaluate such a policy"
            )


def _parse_policies(policies: Any) -> Iterator[tuple[Any, Any]]:
    """The names and origins of policies. A mapping may have any keys."""
    if isinstance(policies, str | os.PathLike):
        yield from _parse_text(os.fsdecode(policies), is_path=isinstance(policies, os.PathLike))
    elif isinstance(policies, Mapping):
        for name, policy in policies.items():
            yield from ((name, origin) for _, origin in _parse_policies(policy))
    elif isinstance(policies, Sequence):
        for policy in policies:
            yield from _parse_policies(policy)
    else:
        policy = _instantiate(policies, policies.__name__) if isinstance(policies, type) else policies
        yield policy_name(policies), policy


def _parse_text(text: str, *, is_path: bool) -> Iterator[tuple[str, str]]:
    r"""The policies in a text: one path, or a list. Each item may be ``NAME=...``. Names hold commas as ``\,``."""
    if is_path or os.path.exists(text):  # noqa: PTH110  (`Path.exists` raises errors for some texts)
        yield _default_name(text), text
        return
    for part in filter(None, (part.strip().replace("\\,", ",") for part in _COMMA.split(text))):
        name, equals, origin = part.partition("=")
        if equals and not origin:  # `Path("")` would be the working directory
            raise SettingsError(f"{part} lacks a policy after the =: give {ACCEPTED_POLICIES}")
        yield (name, origin) if equals else (_default_name(part), part)


def _default_name(origin: str) -> str:
    path = Path(origin)
    if path.suffix in LOADERS:
        return path.stem
    if path.is_dir():
        return (path.resolve().name if path.name in ("", "..") else path.name) or origin
    return origin.rpartition(":")[2]


@cache
def folder_plugins() -> Mapping[str, EntryPoint]:
    """The entry points that load policies, by the name of the file that their folders contain."""
    return announced(
        "policy folder", FOLDER_GROUP, (), re.compile(r"[\w.-]+").fullmatch, '"mine.bin" = "package.module:load"'
    )


def loader_in(folder: Path) -> EntryPoint | None:
    """The entry point that loads the policy in a folder. None if the folder contains no policy."""
    return next((loader for name, loader in folder_plugins().items() if (folder / name).is_file()), None)


def policy_in(folder: Path) -> Act:
    """The policy in a folder. Raises a `SettingsError` if it contains none, or its loader fails or is missing."""
    loader = _folder_loader(folder)
    load = imported("loader of", loader.name, loader, SettingsError)
    with errors_of_user(f"the policy in {folder} cannot be loaded", SettingsError):
        return load(str(folder))


def _folder_loader(folder: Path) -> EntryPoint:
    loader = loader_in(folder)
    if loader is None:
        raise SettingsError(f"the folder {folder} contains no policy: no {' or '.join(folder_plugins())}")
    return loader


def check_policy(policy: Any, name: str) -> None:
    """Raises a `SettingsError` if a policy's type shows that it does not map an observation to an action."""
    model = policy.__self__ if getattr(policy, "__name__", "") == "predict" and ismethod(policy) else policy
    kinds = type(model).__mro__
    if any("__call__" in vars(kind) and not kind.__module__.startswith("torch.") for kind in kinds):
        return  # a function, or an object of a user's class, which may be derived from a library's class
    modules = {kind.__module__ for kind in kinds}
    if any(module.startswith(("stable_baselines3.", "sb3_contrib.")) for module in modules):
        raise SettingsError(
            f"{name} is a model of stable-baselines3, whose predict returns an action and a state: give the file that "
            'model.save("model.zip") writes, or lambda observation: model.predict(observation, deterministic=True)[0]'
        )
    if "torch.nn.modules.module" in modules:
        raise SettingsError(f"{name} is a network, whose input is a tensor. {TORCH}")
    if not callable(policy) and not isinstance(policy, BatchPolicy):
        raise SettingsError(
            f"{name} is not a policy: it is of the type {type(policy).__name__}, and cannot be called; give one "
            f"of {ACCEPTED_POLICIES}, or a function"
        )


def _instantiate(kind: type, name: str) -> Any:
    """An instance of a policy class, created without arguments."""
    try:
        return kind()
    except (Exception, SystemExit) as error:
        raise SettingsError(
            f"the policy {name} is a class, and creating an instance without arguments fails: {reason(error)}. Give a "
            "function or an object, or a class that needs no arguments"
        ) from error


def check_fit(policy: object, pairs: Sequence[Pair], preset: str, like: str = "") -> None:
    """Checks that a policy's `preset`, `tasks` and `observation_shapes`, if it has them, match an evaluation.

    Raises:
        SettingsError: if they do not match.
        TaskError: if the policy needs a plan, and a task has none.
    """
    if getattr(policy, "needs_plan", False):
        for task, _ in pairs:
            if task_spec(task).plan is None:
                task_spec(like or task_spec(task).like or task).check_plan()
    needed = getattr(policy, "preset", preset)
    if needed != preset:
        raise SettingsError(f"the policy needs the preset {needed}, not {preset}: give --preset {needed}")
    _check_tasks(policy, pairs, like)
    shapes, fitting = _accepted(policy), _fitting(policy)
    if shapes and preset not in fitting and "observations" in uses_of(policy):
        remedy = f"give --preset {' or '.join(fitting)}" if fitting else "no preset has observations of this shape"
        gives = observation_space(PRESETS[preset]).shape or "a dict"
        raise SettingsError(f"the policy takes observations of shape {shapes[0]}, and {preset} gives {gives}: {remedy}")


def _check_tasks(policy: object, pairs: Sequence[Pair], like: str) -> None:
    """Raises a `SettingsError` unless the policy's `tasks`, if it has them, contain all tasks of an evaluation."""
    tasks = getattr(policy, "tasks", None)
    if tasks is None:
        return
    if isinstance(tasks, str):
        tasks = (tasks,)
    others = set[str]()
    for task, _ in pairs:
        name = policy_task(task, policy, like)
        if name not in tasks and not (name == NEUTRAL and task in tasks):
            others.add(task if name == NEUTRAL else name)
    if others:
        named = sorted(others)[:SHOWN_TASKS]
        more = f" and {len(others) - len(named)} others" if len(others) > len(named) else ""
        raise SettingsError(
            f"the policy cannot act in {', '.join(named)}{more}: give --tasks {','.join(tasks)}, or --as with one "
            "of them if your task is a modification of it"
        )


def _accepted(policy: object) -> list[Shape]:
    """The shapes of observations that a policy accepts. Empty if it does not name any."""
    return list(getattr(policy, "observation_shapes", None) or ())


def _fitting(policy: object) -> list[str]:
    """The presets whose observations have one of these shapes."""
    accepted = _accepted(policy)

    def fits(name: str) -> bool:
        shape = observation_space(PRESETS[name]).shape or ()  # empty for dicts
        return any(
            len(sizes) == len(shape) and all(size in (None, real) for size, real in zip(sizes, shape, strict=True))
            for sizes in accepted
        )

    return list(filter(fits, PRESETS)) if accepted else []
