"""Functions that run the command line in this or a separate process, and that install other packages."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from PIL import Image
from typer import Context
from typer.core import TyperGroup

from magical_mj.cli import main


def _commands(group: object, before: str = "") -> Iterator[str]:
    if isinstance(group, TyperGroup):
        context = Context(group)
        for name in group.list_commands(context):
            yield before + name
            yield from _commands(group.get_command(context, name), f"{before}{name} ")


@cache
def commands() -> tuple[str, ...]:
    """All commands of `magical-mj`, such as "demos generate". Imports them, which takes half a second."""
    from typer.main import get_command

    from magical_mj.cli.app import app

    return tuple(_commands(get_command(app)))


class Shell:
    """Runs `magical-mj` in this process and captures its output."""

    def __init__(self, capture: pytest.CaptureFixture[str]) -> None:
        self.capture = capture

    def __call__(self, *arguments: object) -> tuple[int, str, str]:
        """Runs a command. Returns exit code, standard output and standard error."""
        code = main([str(argument) for argument in arguments])
        printed = self.capture.readouterr()
        return code, printed.out, printed.err

    def fails(self, code: int, *arguments: object) -> str:
        """Runs a command that must fail with this exit code and one line on standard error. Returns the line."""
        actual, out, error = self(*arguments)
        assert (actual, out) == (code, "")
        assert error.startswith("magical-mj: ")
        assert error.count("\n") == 1
        assert "Value error" not in error
        return error


def process(*arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Runs `magical-mj` in a separate process, with additional environment variables."""
    command = [sys.executable, "-m", "magical_mj", *arguments]
    return subprocess.run(command, env=os.environ | variables, capture_output=True, text=True, check=False, timeout=120)


def opened(path: Path) -> Image.Image:
    """The picture in a file as RGB."""
    with Image.open(path) as picture:
        return picture.convert("RGB")


def example(name: str) -> Path:
    """The folder of a package in examples/."""
    return Path(__file__).parents[2] / "examples" / name


def installed(project: Path, folder: Path) -> Path:
    """Installs a copy of a project with pip, as users do. Returns the folder of the installed packages."""
    site = folder / "site"
    shutil.copytree(project, folder / project.name)
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--disable-pip-version-check", "--target", str(site)]
    command = [sys.executable, "-m", "pip", "install", *options, str(folder / project.name)]
    subprocess.run(command, check=True, capture_output=True)
    return site


def python_beside(site: Path, home: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Runs Python in the folder `home`, with the packages in `site`."""
    path = os.pathsep.join(filter(None, (str(site), os.environ.get("PYTHONPATH"))))
    environment = {**os.environ, "PYTHONPATH": path, "PYTHONWARNINGS": "default"}
    command = [sys.executable, *arguments]
    return subprocess.run(command, cwd=home, env=environment, capture_output=True, text=True, check=False)


def code_block(page: str, language: str, start: str) -> str:
    """The first block of code on a page that begins with `start`."""
    blocks = re.findall(rf"```{language}\n(.*?)```", page, re.DOTALL)
    return next(block for block in blocks if block.startswith(start))
