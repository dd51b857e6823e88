"""Optional dependencies: which packages each extra needs, and one error where they are not installed."""

from __future__ import annotations

import json
from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit
from urllib.request import url2pathname

from magical_mj.utils.errors import MissingExtraError

MODULES: Final = {
    "dask": ("distributed",),
    "eval": ("joblib", "matplotlib", "pandas", "scipy"),
    "gpu": ("mujoco_warp", "torch", "warp"),
    "il": ("kornia", "safetensors", "stable_baselines3", "tensorboard", "torch"),
    "video": ("imageio_ffmpeg",),
}
"""Extra -> the modules that are imported from its packages; see pyproject.toml."""


def check_extra(what: str, *extras: str) -> None:
    """Raises a `MissingExtraError` that says what to install, unless all packages of the extras are installed.

    Args:
        what: the feature that needs them, in the plural, for the message.
        extras: the names of the extras.
    """
    missing = {extra: [name for name in MODULES[extra] if find_spec(name) is None] for extra in extras}
    names = list(dict.fromkeys(name for modules in missing.values() for name in modules))
    if names:
        needed = ",".join(extra for extra in extras if missing[extra])
        raise MissingExtraError(f"{what} need {', '.join(names)}: {remedy(needed)}")


def missing_extra(what: str, extra: str) -> MissingExtraError:
    """The error for a feature (`what`) whose extra is not installed."""
    return MissingExtraError(f"{what} needs its extra: {remedy(extra)}")


def remedy(extra: str) -> str:
    """The command that installs this extra, or several with commas between: as this package itself was installed."""
    try:
        origin = json.loads(distribution("magical-mj").read_text("direct_url.json") or "{}")
    except PackageNotFoundError:  # a checkout that was not installed
        return _from_folder(Path(__file__).parents[2].as_uri(), extra)
    if "dir_info" in origin:
        return _from_folder(origin["url"], extra)
    if "url" in origin:  # of a repository, or of an archive
        vcs = origin.get("vcs_info", {}).get("vcs")
        return f'pip install "magical-mj[{extra}] @ {f"{vcs}+" if vcs else ""}{origin["url"]}"'
    return f'pip install "magical-mj[{extra}]"'


def _from_folder(url: str, extra: str) -> str:
    folder = url2pathname(urlsplit(url).path)
    return f'pip install -e ".[{extra}]" in {folder}' if Path(folder).exists() else f'pip install "magical-mj[{extra}]"'
