"""Runs README.md as a reader would: in a new environment that has only what the page tells to install. `make readme`.

The wheel is built, an environment is made, and then, after the first commands of somebody who has the wheel alone, each
block is run in the page's order: `pip install` with the wheel in place of ".", and Python.

    python tools/readme_run.py [--without SECTION]
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
import venv
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parent.parent
FIRST: Final = """\
$ pip install "."
$ magical-mj --version
$ python -m magical_mj --help
$ magical-mj rollout MoveToRegion --policy expert
"""
BLOCK: Final = re.compile(r"^```(console|python)\n(.*?)^```", re.MULTILINE | re.DOTALL)


def blocks(text: str, without: list[str]) -> list[tuple[str, str]]:
    """The language and the code of each block of the sections that are not left out."""
    sections = re.split(r"^## ", text, flags=re.MULTILINE)
    return [
        block for section in sections if section.partition("\n")[0] not in without for block in BLOCK.findall(section)
    ]


def told(what: str) -> None:
    """Prints at once what is run next, and when."""
    print(f"{time.strftime('%H:%M:%S')} {what}", flush=True)


def run(text: str, without: list[str], folder: Path) -> None:
    """Runs the blocks in a new environment in `folder`; the first that fails ends everything."""
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(folder)],
        cwd=ROOT,
        check=True,
        capture_output=True,
    )
    (wheel,) = folder.glob("*.whl")
    venv.create(folder / "env", with_pip=True)
    programs = folder / "env" / "bin"
    place = folder / "reader"
    place.mkdir()
    variables = {**os.environ, "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}"}
    constraints = f"-q --no-compile --disable-pip-version-check -c {ROOT / 'constraints.txt'}"
    for language, code in [("console", FIRST), *blocks(text, without)]:
        if language == "python":
            told(f"python: {code.splitlines()[0]}")
            subprocess.run([programs / "python", "-c", code], cwd=place, env=variables, check=True)
            continue
        for line in re.findall(r"^\$ (.*)$", code, re.MULTILINE):
            if line.startswith("make "):  # which makes an environment of its own
                continue
            command = re.sub(r'^pip install "\.(\[.*?\])?"', rf'pip install {constraints} "{wheel}\1"', line)
            told(line)
            subprocess.run(["/bin/sh", "-c", command], cwd=place, env=variables, check=True)
            for file in re.findall(r"\S+\.(?:png|mp4)\b", command):
                if not (place / file).stat().st_size:
                    sys.exit(f"{file} is empty")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--without", action="append", default=[], metavar="SECTION", help="leave this one out")
    with tempfile.TemporaryDirectory() as folder:
        run((ROOT / "README.md").read_text(encoding="utf-8"), parser.parse_args().without, Path(folder))
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    told(f"all of it ran, in {used.ru_utime + used.ru_stime:.0f} s of one core")
