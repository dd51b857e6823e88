"""Optional dependencies: the packages of each extra, and the error if they are not installed."""

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
    "eval": ("confusable_homoglyphs", "matplotlib", "pandas", "scipy"),
    "gpu": ("mujoco_warp", "torch", "warp"),
    "il": ("kornia", "safetensors", "tensorboard", "tomli_w", "torch"),
    "minari": ("h5py", "minari"),
    "onnx": ("onnx", "onnxruntime", "onnxscript"),
    "robomimic": ("h5py",),
    "video": ("imageio_ffmpeg",),
    "web": ("websockets",),
    "window": ("pygame",),
}
"""Extra -> the imported modules of its packages; see pyproject.toml. Packages for only some platforms are left out."""


def check_extra(what: str, *extras: str) -> None:
    """Raises a `MissingExtraError` with the install command, unless all packages of the extras are installed.

    `what` is the feature that needs them, in the plural, for the message.
    """
    missing = [(extra, name) for extra in extras for name in MODULES[extra] if find_spec(name) is None]
    if missing:
        needed, names = map(dict.fromkeys, zip(*missing, strict=True))
        raise MissingExtraError(f"{what} need {', '.join(names)}: {remedy(','.join(needed))}")


def check_module(what: str, name: str, extra: str) -> None:
    """Raises a `MissingExtraError` unless this module of an extra is installed. Only some uses of the extra need it."""
    if find_spec(name) is None:
        raise MissingExtraError(f"{what} need {name}: {remedy(extra)}")


def remedy(extra: str) -> str:
    """The command that installs this extra, or several separated by commas, from the source of this package."""
    try:
        origin = json.loads(distribution("magical-mj").read_text("direct_url.json") or "{}")
    except PackageNotFoundError:  # a checkout without installation
        origin = {"url": Path(__file__).parents[2].as_uri(), "dir_info": {"editable": True}}
    if origin.get("dir_info", {}).get("editable"):
        return f'pip install -e "{url2pathname(urlsplit(origin["url"]).path)}[{extra}]"'
    repository = f"{origin['vcs_info']['vcs']}+" if "vcs_info" in origin else ""
    source = f" @ {repository}{origin['url']}" if "url" in origin else ""
    return f'pip install "magical-mj[{extra}]{source}"'
