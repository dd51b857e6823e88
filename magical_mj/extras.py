"""The packages that only some features need, and one error for those that are not installed."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Final

from magical_mj.errors import MissingExtraError

MODULES: Final = {
    "eval": ("joblib", "jsonschema", "matplotlib", "pandas", "scipy"),
    "gpu": ("mujoco_warp", "torch", "warp"),
    "il": ("kornia", "safetensors", "stable_baselines3", "tensorboard", "torch"),
}
"""What is imported from the packages of an extra; see pyproject.toml."""


def check_extra(what: str, *extras: str) -> None:
    """Raises a `MissingExtraError` that says what to install, unless the packages of the extras are all there.

    Args:
        what: what needs them, in the plural.
        extras: their names; the last one installs the others too.
    """
    missing = [name for extra in extras for name in MODULES[extra] if find_spec(name) is None]
    if missing:
        raise MissingExtraError(f"{what} need {', '.join(missing)}: {_remedy(extras[-1])}")


def missing_extra(what: str, extra: str) -> MissingExtraError:
    """The error for something that needs an extra which is not installed."""
    return MissingExtraError(f"{what} needs its extra: {_remedy(extra)}")


def _remedy(extra: str) -> str:
    return f'pip install "magical-mj[{extra}]"'
