"""docs/composer.md: its code runs, and what it says of composer's environments holds."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("dm_control", reason="dm_control does not install with this Python or MuJoCo")

import magical_mj

PAGE = (Path(__file__).parents[2] / "docs" / "composer.md").read_text("utf-8")
BLOCKS = re.findall(r"^#+ (.*?)\n(?:(?!^#).*\n)*?```python\n(.*?)```", PAGE, re.MULTILINE)
CODE = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


@pytest.mark.parametrize("code", CODE, ids=range(len(CODE)))
def test_code_runs(code: str) -> None:
    exec(compile(code, "composer.md", "exec"), {"__name__": "composer_page"})
