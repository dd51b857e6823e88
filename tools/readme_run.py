"""Runs the commands of README.md in a new environment with only the packages that the page installs. `make readme`.

It builds the wheel, makes an environment, and runs the first commands of a user who has only the wheel. Then it runs
each block in the page's order: Python code, and `pip install` with the wheel instead of ".".

    python tools/readme_run.py
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


def log(message: str) -> None:
    """Prints a message with the time, without buffering."""
    print(f"{time.strftime('%H:%M:%S')} {message}", flush=True)


def run(text: str, folder: Path) -> None:
    """Runs the blocks in a new environment in `folder`. Raises an error if one fails."""
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(folder)],
        cwd=ROOT,
        check=True,
        capture_output=True,
    )
    (wheel,) = folder.glob("*.whl")
    venv.create(folder / "env", with_pip=True)
    programs = folder / "env" / "bin"
    reader = folder / "reader"
    reader.mkdir()
    variables = {**os.environ, "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}"}
    variables.pop("PYTHONDONTWRITEBYTECODE", None)  # the first command compiles for the others
    constraints = f"-q --no-compile --disable-pip-version-check -c {ROOT / 'constraints.txt'}"
    for language, code in [("console", FIRST), *BLOCK.findall(text)]:
        if language == "python":
            log(f"python: {code.splitlines()[0]}")
            subprocess.run([programs / "python", "-c", code], cwd=reader, env=variables, check=True)
            continue
        for line in re.findall(r"^\$ (.*)$", code, re.MULTILINE):
            if line.startswith("make "):  # make would create its own environment
                continue
            command = re.sub(r'^pip install "\.(\[.*?\])?"', rf'pip install {constraints} "{wheel}\1"', line)
            log(line)
            subprocess.run(["/bin/sh", "-c", command], cwd=reader, env=variables, check=True)
            for file in re.findall(r"\S+\.(?:png|mp4)\b", command):
                if not (reader / file).stat().st_size:
                    sys.exit(f"{file} is empty")


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    with tempfile.TemporaryDirectory() as folder:
        run((ROOT / "README.md").read_text(encoding="utf-8"), Path(folder))
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    log(f"all commands succeeded, in {used.ru_utime + used.ru_stime:.0f} s of processor time")
