"""The formats of data sets by name, as `magical-mj demos export` offers them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from typing import Final

from magical_mj.demos.archive import to_npz
from magical_mj.demos.demonstration import SUFFIX, Demonstration
from magical_mj.exports.folders import to_webdataset, to_xirl
from magical_mj.exports.lerobot import PRESETS, to_lerobot
from magical_mj.exports.minari import minari_name, to_minari
from magical_mj.exports.robomimic import to_robomimic
from magical_mj.protocol import DEMONSTRATIONS
from magical_mj.utils.errors import SettingsError

SUFFIXES: Final = {"npz": SUFFIX, "robomimic": ".hdf5"}
"""Format -> the suffix of its files. The other formats write folders."""


def views_of(preset: str) -> str:
    """The choice of views for LeRobot and robomimic. These libraries stack frames themselves.

    Raises a `SettingsError` if the preset is not available for their data sets.
    """
    views = {name: views for views, name in PRESETS.items()}
    if preset not in views:
        raise SettingsError(f"data sets of LeRobot and robomimic can have the presets {', '.join(views)}, not {preset}")
    return views[preset]


def digest_tag(demos: Iterable[Demonstration]) -> str:
    """The part of a data set's name that identifies its demonstrations: the shipped ones' number, and a digest."""
    digest = hashlib.sha256("".join(demo.digest for demo in demos).encode())
    return f"-d{DEMONSTRATIONS}-{digest.hexdigest()[:8]}"


def default_target(
    to: str, environment: str, demos: Sequence[Demonstration], preset: str, *, fingers: bool = False, tag: str = ""
) -> str:
    """The default path or id of a data set in the format `to`. It contains `tag`."""
    if to == "minari":
        return minari_name(demos, preset, tag)
    observed = f"{views_of(preset)}{'-fingers' * fingers}" if to in ("lerobot", "robomimic") else preset or "views"
    name = f"{environment}{tag}" if to == "xirl" else f"{environment}{tag}-{observed}"
    return name + SUFFIXES.get(to, f"-{to}")


def make_data_set(
    to: str,
    demos: Sequence[Demonstration],
    target: str,
    preset: str,
    *,
    drop_noop: bool = True,
    video: bool = False,
    fingers: bool = False,
    overwrite: bool = False,
) -> None:
    """Writes a data set in the format `to`. Options that the format does not have are ignored."""
    match to:
        case "npz":
            to_npz(demos, target, preset, drop_noop=drop_noop, overwrite=overwrite)
        case "minari":
            to_minari(demos, target, preset, overwrite=overwrite)
        case "webdataset":
            to_webdataset(demos, target, preset, overwrite=overwrite)
        case "xirl":
            to_xirl(demos, target, overwrite=overwrite)
        case "lerobot":  # existing folders are never replaced
            to_lerobot(demos, target, views=views_of(preset), fingers=fingers, video=video)
        case _:
            to_robomimic(demos, target, views=views_of(preset), overwrite=overwrite)
