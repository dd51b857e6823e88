"""Settings: their checks, changes from text, and what the command line learns from them."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pytest
from msgspec import Meta

from magical_mj.utils.errors import SettingsError, UnknownNameError
from magical_mj.utils.settings import Count, Names, Settings, described, with_changes, with_values


@dataclass(frozen=True)
class Oven(Settings):
    part: ClassVar[str] = "oven"
    heat: Annotated[float, Meta(gt=0, le=300)] = 180.0
    fan: bool = False


@dataclass(frozen=True, kw_only=True)
class Cake(Settings):
    eggs: Annotated[Count, Meta(description="How many.")] = 3
    layers: Annotated[Count | None, Meta(description="None: as many as fit.")] = None
    taste: Literal["sweet", "salty"] = "sweet"
    guests: Annotated[Names, Meta(description="Who eats it.")] = "all"
    recipe: Path | None = None
    sizes: tuple[int, ...] = ()
    notes: dict[str, Any] = field(default_factory=dict)
    oven: Oven = field(default_factory=Oven)


def test_values_become_pythons_own() -> None:
    cake = Cake(eggs=np.int64(4), guests=iter(["Ann", "Bob"]), recipe="cake.txt", oven=Oven(heat=200))  # pyright: ignore[reportArgumentType]
    assert cake == Cake(eggs=4, guests=("Ann", "Bob"), recipe=Path("cake.txt"), oven=Oven(200.0))
    assert (type(cake.eggs), type(cake.oven.heat)) == (int, float)


@pytest.mark.parametrize(
    ("values", "problem"),
    [
        ({"eggs": 0}, "eggs must be an integer of at least 1, not 0"),
        ({"eggs": True}, "eggs must be an integer of at least 1, not True"),
        ({"eggs": "3"}, "eggs must be an integer of at least 1, not '3'"),
        ({"eggs": 10**30}, "eggs must be an integer of at most 1000000, not 1000000000000000000000000000000"),
        ({"layers": 1.5}, "layers must be an integer of at least 1, not 1.5"),
        ({"guests": 3}, "guests must be names, as a list or separated by commas, not 3"),
        ({"eggs": "\ud800"}, "eggs must be an integer of at least 1, not '\\ud800'"),
        ({"recipe": 3}, "recipe must be a path, not 3"),
        ({"sizes": "3"}, "sizes must be a list of integers, not '3'"),
        ({"notes": 3}, "notes must be a table, not 3"),
        ({"taste": "swet"}, "Did you mean 'sweet'"),
        ({"egs": 3}, "Did you mean 'eggs'"),
        ({"oven": 3}, "oven must be of the type Oven, not 3"),
    ],
)
def test_errors_list_the_allowed_values(values: dict[str, Any], problem: str) -> None:
    with pytest.raises((SettingsError, UnknownNameError)) as caught:
        with_values(Cake, values)
    assert problem in str(caught.value)


def test_changes_may_be_text_and_reach_parts() -> None:
    changes = {"oven.heat": "2e2", "oven.fan": "true", "eggs": "2"}
    assert with_changes(Cake, changes) == Cake(eggs=2, oven=Oven(200, True))
    for changes, problem in (
        ({"oven.heat": "0"}, "oven.heat must be a number above 0, not '0'"),
        ({"oven.heat": "nan"}, "oven.heat must be a number above 0"),
        ({"oven.het": 3}, "Did you mean 'oven.heat'"),
    ):
        with pytest.raises((SettingsError, UnknownNameError)) as caught:
            with_changes(Cake, changes)
        assert problem in str(caught.value)


@dataclass(frozen=True, kw_only=True)
class Biscuit(Cake):
    oven: Oven = field(default_factory=lambda: Oven(heat=150.0))


def test_changes_keep_the_defaults_that_a_subclass_gives_to_parts() -> None:
    assert with_changes(Biscuit, {"eggs": 1}).oven == Oven(heat=150.0)
    assert with_changes(Biscuit, {"oven.fan": True}).oven == Oven(heat=150.0, fan=True)


def test_the_command_line_learns_types_bounds_and_meanings() -> None:
    known = described(Cake)
    assert list(known) == ["eggs", "layers", "taste", "guests", "recipe", "sizes", "notes", "oven.heat", "oven.fan"]
    assert known["eggs"][:4] == (int, 3, "How many.", 1)
    assert known["layers"][:4] == (int | None, None, "None: as many as fit.", 1)
    assert known["recipe"].kind == Path | None
