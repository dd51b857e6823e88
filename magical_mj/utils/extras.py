"""Optional dependencies: which packages each extra needs, and one error where they are not installed."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Final

from magical_mj.utils.errors import MissingExtraError

MODULES: Final = {
    "dask": ("distributed",),
    "eval": ("fastjsonschema", "joblib", "matplotlib", "pandas", "scipy"),
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
        remedy = _remedy(",".join(extra for extra in extras if missing[extra]))
        raise MissingExtraError(f"{what} need {', '.join(names)}: {remedy}")


def missing_extra(what: str, extra: str) -> MissingExtraError:
    """The error for a feature (`what`) whose extra is not installed."""
    return MissingExtraError(f"{what} needs its extra: {_remedy(extra)}")


def _remedy(extra: str) -> str:
    return f'pip install "magical-mj[{extra}]"'
