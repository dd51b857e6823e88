"""How tests run the command line: in this process, or in one of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from PIL import Image
from typer import Context
from typer.core import TyperGroup
from typer.main import get_command

from magical_mj.cli import main
from magical_mj.cli.app import app


def _commands(group: object, before: str = "") -> Iterator[str]:
    if isinstance(group, TyperGroup):
        context = Context(group)
        for name in group.list_commands(context):
            yield before + name
            yield from _commands(group.get_command(context, name), f"{before}{name} ")


COMMANDS = tuple(_commands(get_command(app)))
"""All commands of `magical-mj`, such as "demos generate"."""


class Shell:
    """Runs `magical-mj` in this process and keeps what it printed."""

    def __init__(self, capture: pytest.CaptureFixture[str]) -> None:
        self.capture = capture

    def __call__(self, *arguments: object) -> tuple[int, str, str]:
        """Exit code, standard output and standard error."""
        code = main([str(argument) for argument in arguments])
        printed = self.capture.readouterr()
        return code, printed.out, printed.err

    def fails(self, code: int, *arguments: object) -> str:
        """The one line that the command complains with."""
        actual, out, error = self(*arguments)
        assert (actual, out) == (code, "")
        assert error.startswith("magical-mj: ")
        assert error.count("\n") == 1
        assert "Value error" not in error
        return error


def process(*arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Runs `magical-mj` in a process of its own, with these environment variables besides the present ones."""
    command = [sys.executable, "-m", "magical_mj", *arguments]
    return subprocess.run(command, env=os.environ | variables, capture_output=True, text=True, check=False, timeout=120)


def opened(path: Path) -> Image.Image:
    """The picture in a file, RGB."""
    with Image.open(path) as picture:
        return picture.convert("RGB")
