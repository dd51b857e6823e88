"""The packages that only evaluations need."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Final

from magical_mj.errors import EvaluationError

PACKAGES: Final = ("joblib", "matplotlib", "pandas", "scipy")


def check_extra() -> None:
    """Raises an `EvaluationError` that says what to install, unless all are there."""
    missing = [name for name in PACKAGES if find_spec(name) is None]
    if missing:
        raise EvaluationError(f'evaluations need {", ".join(missing)}: pip install "magical-mj[eval]"')
