"""Settings: frozen dataclasses. A field defines a setting's type, bounds, meaning and default for all interfaces.

A field is annotated, ``episodes: Annotated[Count, Meta(description="Episodes in each environment.")] = 100``. A
subclass of `Settings` checks all its fields when an object is created. `with_changes` accepts values as text, and
`described` returns the data for command-line options. Settings may contain other settings as parts.

msgspec converts the values: it loads in half of pydantic's time, and has no dependencies.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Literal, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

import msgspec
import numpy as np
from msgspec import Meta, inspect

from magical_mj.utils.errors import SettingsError, UnknownArgumentError, check_name, short_repr, unknown_name

T = TypeVar("T")

LARGEST_SETTING: Final = 1_000_000
"""The upper limit of counts, such as episodes, workers and seconds."""
_LENGTH: Final = 300
"""The number of characters of a setting that are shown in a message about a difference."""

Count = Annotated[int, Meta(ge=1, le=LARGEST_SETTING)]
"""An integer of at least 1."""
Natural = Annotated[int, Meta(ge=0, le=LARGEST_SETTING)]
"""An integer of at least 0."""
Names = str | Iterable[str]
"""Names, as one string separated by commas or as an iterable, which is converted to a tuple."""

_WORDS: Final[Mapping[type, str]] = {
    inspect.BoolType: "true or false",
    inspect.IntType: "an integer",
    inspect.FloatType: "a number",
    inspect.StrType: "a string",
    inspect.CustomType: "a path",
    inspect.DictType: "a table",
}
_LISTS: Final[Mapping[type, str]] = {inspect.IntType: "a list of integers", inspect.StrType: "a list of strings"}


class Setting(NamedTuple):
    """The data of a setting for the command line."""

    kind: Any
    """Its type, without bounds."""
    default: Any
    description: str
    least: float | None
    """The smallest allowed number, for numbers with a lower bound."""
    observes: str
    """The observations that it affects, such as "pictures"; empty: all."""


@dataclass(frozen=True)
class Settings:
    """The base of settings. It checks and converts their values.

    Subclasses that are parts of other settings give the name of their field, for messages: ``part="ppo"``.

    Raises:
        SettingsError: if a value has another type or is out of bounds.
        UnknownNameError: if a name is not one of the allowed names.
    """

    part: ClassVar[str] = ""
    panel: ClassVar[str | None] = None
    """The heading of a class's settings in the help of a command. None: they are among the first options."""

    @classmethod
    def panel_of(cls, name: str) -> str | None:
        """The `panel` of the class that declares a setting."""
        return next(kind.panel for kind in cls.__mro__ if name in vars(kind).get("__annotations__", ()))

    def __init_subclass__(cls, part: str = "") -> None:
        cls.part = part or cls.part

    def __post_init__(self) -> None:
        for name, kind in annotated(type(self)).items():
            path = f"{self.part}.{name}" if self.part else name
            object.__setattr__(self, name, fitting(path, getattr(self, name), kind))


def fitting(name: str, value: Any, kind: Any, *, text: bool = False) -> Any:
    """The value of a setting, converted to its type.

    Args:
        name: the setting's name, for messages.
        value: the value. Numbers of numpy are accepted. Bools are not accepted as numbers.
        kind: the annotation of its field, a type with `Meta`; ``ge``, ``gt`` and ``le`` are bounds.
        text: whether numbers and bools may be given as text, as in ``--set ppo.clip=0.02``.

    Raises:
        SettingsError: if it does not fit the type.
        UnknownNameError: if it is not one of the names of a `Literal`.
    """
    plain = _plain(kind)
    if is_dataclass(plain):
        if not isinstance(value, plain):  # pyright: ignore[reportArgumentType]
            raise SettingsError(f"{name} must be of the type {plain.__name__}, not {short_repr(value)}")  # pyright: ignore[reportAttributeAccessIssue]
        return value
    _check_choice(name, value, plain)
    try:
        if isinstance(value, np.generic):
            value = value.item()
        if plain == Names:
            kind = str | tuple[str, ...]
            value = value if isinstance(value, str) else tuple(value)
        return msgspec.convert(value, kind, strict=not text, dec_hook=lambda cls, given: cls(given))
    except (msgspec.ValidationError, TypeError, UnicodeError):  # not iterable, or invalid Unicode
        raise SettingsError(f"{name} must be {_wanted(plain, kind, value)}, not {short_repr(value)}") from None


def _check_choice(name: str, value: Any, plain: Any) -> None:
    """Raises an `UnknownNameError` if the type is a `Literal`, or a `Literal` or None, without this name."""
    names = next((part for part in (plain, *get_args(plain)) if get_origin(part) is Literal), None)
    if names is not None and (value is not None or names is plain):
        check_name(name, value, get_args(names))


@lru_cache
def described(settings: type, prefix: str = "") -> Mapping[str, Setting]:
    """All settings by name, in order. A setting of a part has a name such as ``ppo.clip``."""
    known: dict[str, Setting] = {}
    types = get_type_hints(settings)
    for item in fields(settings):
        kind, path = annotated(settings)[item.name], f"{prefix}{item.name}"
        if is_dataclass(part := _plain(kind)):
            known |= described(part, f"{path}.")
        else:
            notes = [note for note in get_args(kind) if isinstance(note, Meta)]
            description = "".join(note.description or "" for note in notes)
            observes = "".join((note.extra or {}).get("observes", "") for note in notes)
            least = None if part == Names else getattr(_information(kind), "ge", None)
            known[path] = Setting(types[item.name], item.default, description, least, observes)
    return known


def with_values(settings: Callable[..., T], values: Mapping[str, Any]) -> T:
    """Settings with these values, and defaults for all others.

    Raises:
        UnknownArgumentError: for an unknown name.
        UnknownNameError, SettingsError: for an invalid value.
    """
    _check_known(values, annotated(settings))
    return settings(**values)


def with_changes(settings: Callable[..., T], changes: Mapping[str, Any]) -> T:
    """As `with_values`, but values may be text. Names of parts' settings contain dots, as in "ppo.clip"."""
    _check_known(changes, described(settings))
    return _with_changes(settings, changes, "", None)


def _check_known(names: Iterable[str], known: Collection[str]) -> None:
    """Raises an `UnknownArgumentError` unless all names are known."""
    for name in names:
        if name not in known:
            raise UnknownArgumentError(str(unknown_name("setting", name, known)))


def _with_changes(settings: Callable[..., T], changes: Mapping[str, Any], prefix: str, default: Any) -> T:
    """New settings with these changes. `default` has the other values of a part. None: those of the class."""
    values: dict[str, Any] = {}
    for item in fields(settings):  # pyright: ignore[reportArgumentType]
        kind, path = annotated(settings)[item.name], f"{prefix}{item.name}"
        if is_dataclass(_plain(kind)):
            part = item.default if item.default_factory is MISSING else item.default_factory()
            part = part if default is None else getattr(default, item.name)
            values[item.name] = _with_changes(type(part), changes, f"{path}.", part)
        elif path in changes:
            values[item.name] = fitting(path, changes[path], kind, text=True)
        elif default is not None:
            values[item.name] = getattr(default, item.name)
    return settings(**values)


@lru_cache
def annotated(settings: Any) -> dict[str, Any]:
    """The annotations of a class's settings by name, in order. Parts are not expanded."""
    hints = get_type_hints(settings, include_extras=True)
    return {item.name: hints[item.name] for item in fields(settings)}


def check_unchanged(folder: Path, before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """Raises a `SettingsError` with the differences, if a folder was started with other settings."""
    differences = [
        f"{name} was {_short(before.get(name))} and is {_short(value)}"
        for name, value in now.items()
        if before.get(name) != value
    ]
    if differences:
        raise SettingsError(f"{folder} was started with other settings: {'; '.join(differences)}")


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= _LENGTH else f"{text[: _LENGTH // 2]} ... {text[-_LENGTH // 2 :]}"


def _plain(kind: Any) -> Any:
    """A type without its annotations."""
    return get_args(kind)[0] if get_origin(kind) is Annotated else kind


def _information(kind: Any) -> inspect.Type:
    """Msgspec's information about a type; for a union, such as ``Count | None``, about its first type."""
    known = inspect.type_info(kind)
    known = known.type if isinstance(known, inspect.Metadata) else known
    return known.types[0] if isinstance(known, inspect.UnionType) else known


def _wanted(plain: Any, kind: Any, value: Any) -> str:
    """A description of a setting's valid values, such as "an integer of at least 1"."""
    if plain == Names:
        return "names, as a list or separated by commas"
    known = _information(kind)
    words = _WORDS.get(type(known), "valid")
    if isinstance(known, inspect.VarTupleType):
        words = _LISTS.get(type(known.item_type), "a list")
    least, above, most = (getattr(known, bound, None) for bound in ("ge", "gt", "le"))
    if isinstance(value, str):  # from the command line
        with suppress(ValueError):
            value = float(value)
    if most is not None and type(value) in (int, float) and value > most:
        return f"{words} of at most {most}"
    bound = "" if least is None else f" of at least {least}"
    return words + (bound if above is None else f" above {above}")
