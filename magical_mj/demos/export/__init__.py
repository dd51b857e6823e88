"""Demonstrations for other tools: what `magical-mj demos export` offers, by the name of the format."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from magical_mj.demos.demonstration import Demonstration
from magical_mj.demos.export.archives import to_npz, to_robomimic
from magical_mj.demos.export.lerobot import PRESETS, to_lerobot
from magical_mj.demos.export.minari import minari_name, to_minari
from magical_mj.demos.files import SUFFIX
from magical_mj.utils.errors import SettingsError


class Exporter(NamedTuple):
    """How demonstrations become a data set of one format."""

    write: Callable[..., object]
    """(demonstrations, target, preset, overwrite=..., and the options) makes a data set."""
    target: Callable[[str, Sequence[Demonstration], str, Mapping[str, Any]], str]
    """(environment, demonstrations, preset, options) -> the path or id of the data set if the user gives none."""
    suffix: str
    """How the names of files end; empty if data sets are folders."""
    preset: str = "LoRes4E"
    """The preset of the observations if the user gives none."""
    options: tuple[str, ...] = ()
    """The options of the format."""
    replaces: bool = True
    """Whether data sets that exist can be replaced."""
    of_many: bool = False
    """Whether one data set holds demonstrations of several environments."""


def views_of(preset: str) -> str:
    """What policies of LeRobot and robomimic see, which stack frames themselves if they want any.

    Raises:
        SettingsError: if their data sets cannot be of this preset.
    """
    views = {name: views for views, name in PRESETS.items()}
    if preset not in views:
        raise SettingsError(f"data sets of LeRobot and robomimic are of the presets {', '.join(views)}, not {preset}")
    return views[preset]


def _lerobot(demos: Sequence[Demonstration], folder: str, preset: str, *, overwrite: bool, **options: Any) -> object:
    del overwrite  # LeRobot writes into new folders only
    return to_lerobot(demos, folder, views=views_of(preset), **options)


def _robomimic(demos: Sequence[Demonstration], path: str, preset: str, *, overwrite: bool) -> object:
    return to_robomimic(demos, path, views=views_of(preset), overwrite=overwrite)


EXPORTERS: Final[Mapping[str, Exporter]] = MappingProxyType(
    {
        "npz": Exporter(
            to_npz,
            lambda environment, _demos, preset, _options: f"{environment}-{preset or 'views'}{SUFFIX}",
            SUFFIX,
            options=("drop_noop",),
            of_many=True,
        ),
        "minari": Exporter(
            to_minari,
            lambda _environment, demos, preset, _options: minari_name(demos, preset),
            "",
            preset="State",
        ),
        "lerobot": Exporter(
            _lerobot,
            lambda environment, _demos, preset, options: (
                f"{environment}-{views_of(preset)}{'-fingers' if options['fingers'] else ''}-lerobot"
            ),
            "",
            options=("video", "fingers"),
            replaces=False,
        ),
        "robomimic": Exporter(
            _robomimic,
            lambda environment, _demos, preset, _options: f"{environment}-{views_of(preset)}.hdf5",
            ".hdf5",
        ),
    }
)
