"""Loading policies: from names, ``module:object``, model files, folders of trainings, or Python objects."""

from __future__ import annotations

import hashlib
import inspect
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Final

from magical_mj.policies.agents import AGENTS
from magical_mj.policies.failures import reason
from magical_mj.policies.folders import FOLDERS, loader_in
from magical_mj.policies.interface import Act, policy_name
from magical_mj.policies.models import LOADERS
from magical_mj.utils.errors import SettingsError, UntrustedNameError, shown, unknown_name
from magical_mj.utils.imports import resolve, source_of

ACCEPTED_POLICIES: Final = (
    f"{', '.join(AGENTS)}, module:object, a file that ends in {' or '.join(LOADERS)}, or a run's folder"
)


@dataclass(frozen=True)
class Source:
    """One policy to be evaluated; small and picklable if it was given by name.

    Attributes:
        name: the method's name in tables.
        run: the number of the run of the method.
        origin: a built-in's name, ``module:object``, a file, a folder, or the policy itself.
        trust: whether files that hold code may be loaded.
        digest: the hash that the policy's file must have; None: any.
    """

    name: str
    run: int
    origin: Any
    trust: bool = False
    digest: str | None = None

    def load(self) -> Act:
        """The policy.

        Raises:
            SettingsError: if there is no such policy, it is invalid, or its file is not the expected one any more.
        """
        was_imported = isinstance(self.origin, str) and source_of(self.origin) is not None
        policy = self._load()
        if self.digest is not None and not was_imported and self.digest not in self._hash().values():
            raise SettingsError(
                f"{self.origin} was changed while it was evaluated, so that its scores would be of two policies: "
                "evaluate a copy"
            )
        return policy

    def fixed(self) -> Source:
        """This policy as it is now, after it was loaded: if its file changes later, `load` refuses it."""
        return replace(self, digest=next(iter(self._hash().values()), None))

    def _load(self) -> Act:
        if not isinstance(self.origin, str):
            return self.origin
        if self.origin in AGENTS:
            return AGENTS[self.origin]()
        suffix = Path(self.origin).suffix
        if suffix in LOADERS:
            if not Path(self.origin).is_file():
                raise SettingsError(f"there is no file {self.origin}")
            return LOADERS[suffix](Path(self.origin), self.trust)
        if Path(self.origin).is_dir():
            return _folder_loader(self.origin).load()(self.origin)
        if ":" in self.origin:
            return _imported(self.origin)
        raise unknown_name("policy", self.origin, (*AGENTS, "module:object", *(f"FILE{s}" for s in LOADERS)))

    def describe(self) -> dict[str, Any]:
        """The facts about the policy that must be the same when an evaluation is resumed."""
        origin = self.origin if isinstance(self.origin, str) else f"a Python object: {type(self.origin).__qualname__}"
        return {"name": self.name, "run": self.run, "origin": origin, **self._hash()}

    def _hash(self) -> dict[str, str]:
        """The hash of the policy's file ("sha256") or of its module's ("code"); nothing if there is none."""
        if not isinstance(self.origin, str) or self.origin in AGENTS:
            return {}
        policy = self._file()
        what, file = ("sha256", policy) if policy is not None else ("code", source_of(self.origin))
        return {} if file is None else {what: hashlib.sha256(file.read_bytes()).hexdigest()}

    def _file(self) -> Path | None:
        """The file that holds the policy, if there is one."""
        path = Path(self.origin)
        if path.suffix in LOADERS:
            return path
        return path / _folder_loader(self.origin).name if path.is_dir() else None


def sources(policies: Any, run: int = 0, trust: bool = False) -> list[Source]:
    """The policies in the argument of `evaluate`; those with the same name are successive runs of one method.

    Args:
        policies: a policy or a list of them; each a name, ``module:object``, a file, a folder, any of them as
            ``NAME=...``, a path, a mapping of such names to policies or lists of them, or a policy object.
        run: the number of the first run.
        trust: whether files that hold code may be loaded.
    """
    found: list[Source] = []
    seen: Counter[str] = Counter()
    for source in _each(policies):
        if not isinstance(source.name, str) or not source.name.strip() or not source.name.isprintable():
            raise SettingsError(f"the name of a method is a text of printable characters, not {shown(source.name)}")
        found.append(replace(source, run=run + seen[source.name], trust=trust))
        seen[source.name] += 1
    if not found:
        raise SettingsError(f"give a policy: {ACCEPTED_POLICIES}")
    return found


def _each(policies: Any) -> Iterator[Source]:
    if isinstance(policies, os.PathLike):
        path = os.fspath(policies)
        yield Source(_short(path), 0, path)
    elif isinstance(policies, str) and os.path.exists(policies):  # noqa: PTH110  (Path's raises errors)
        yield Source(_short(policies), 0, policies)
    elif isinstance(policies, str):
        for text in filter(None, (part.strip() for part in policies.split(","))):
            name, equals, origin = text.partition("=")
            if equals and not origin:  # else it would be the working directory
                raise SettingsError(f"{text} names no policy: {ACCEPTED_POLICIES}")
            yield Source(name, 0, origin) if equals else Source(_short(text), 0, text)
    elif isinstance(policies, Mapping):
        for name, given in policies.items():
            for source in _each(given):
                yield replace(source, name=name)
    elif isinstance(policies, Sequence):
        for given in policies:
            yield from _each(given)
    elif isinstance(policies, type):
        yield Source(policies.__name__, 0, _made(policies, policies.__name__))
    elif callable(policies):
        yield Source(policy_name(policies), 0, policies)
    else:
        raise SettingsError(f"{shown(policies)} is not a policy: it must be callable, or one of {ACCEPTED_POLICIES}")


def _short(origin: str) -> str:
    path = Path(origin)
    if path.suffix in LOADERS:
        return path.stem
    if path.is_dir():
        return path.resolve().name if path.name in ("", "..") else path.name
    return origin.rpartition(":")[2]


def _folder_loader(folder: str) -> EntryPoint:
    """The entry point that loads the policy in a folder."""
    found = loader_in(Path(folder))
    if found is None:
        known = " or ".join(loader.name for loader in entry_points(group=FOLDERS))
        raise SettingsError(f"the folder {folder} holds no policy: no {known}")
    return found


def _imported(origin: str) -> Act:
    """The object that ``module:object`` refers to; a class is instantiated."""
    try:
        found = resolve(origin)
    except UntrustedNameError:
        raise
    except (Exception, SystemExit) as error:
        raise SettingsError(f"the policy {origin} cannot be imported: {reason(error)}") from error
    if inspect.isclass(found):
        found = _made(found, origin)
    if not callable(found):
        raise SettingsError(f"the policy {origin} is a {type(found).__name__}, which cannot be called")
    return found


def _made(kind: type, name: str) -> Any:
    """An instance of a policy class, made without arguments."""
    try:
        return kind()
    except (Exception, SystemExit) as error:
        raise SettingsError(
            f"the policy {name} is a class, and calling it fails: {reason(error)}. Give a function or an object, "
            "or a class that needs no arguments"
        ) from error
