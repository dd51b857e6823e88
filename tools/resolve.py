"""Prints the systems and Python versions that can install the package, with wheels for all dependencies.

It downloads only metadata: `uv pip compile` resolves dependencies for other systems. (pip's own option --python-version
is not used, because it evaluates the markers in requirements for the Python that runs it.)

    python tools/resolve.py [--extras "" all il]
"""

from __future__ import annotations

import argparse
import os
import subprocess
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parent.parent
PYTHONS: Final = ("3.11", "3.12", "3.13", "3.14", "3.15")
SYSTEMS: Final = {
    "Linux x86-64": "x86_64-manylinux_2_28",
    "Linux arm64": "aarch64-manylinux_2_28",
    "macOS 14 arm64": "aarch64-apple-darwin",
    "Windows": "x86_64-pc-windows-msvc",
}
"""System -> its name in uv."""
SHOWN: Final = ("mujoco", "numpy", "dm-control", "torch")


def resolved(python: str, system: str, extra: str) -> str:
    """The versions of the most important packages, or the resolver's error."""
    command = ["uv", "pip", "compile", "--quiet", "--only-binary", ":all:", "--no-header", "--no-annotate"]
    command += ["--python-version", python, "--python-platform", SYSTEMS[system], "pyproject.toml"]
    command += ["--extra", extra] if extra else []
    variables = {**os.environ, "MACOSX_DEPLOYMENT_TARGET": "14.0"}
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, env=variables)
    if done.returncode != 0:
        return f"no: {' '.join(done.stderr.split())[:300]}"
    versions = dict(line.split("==") for line in done.stdout.splitlines() if "==" in line)
    names = (name for name in SHOWN if name in versions)
    return f"{len(versions)} packages: {', '.join(f'{name} {versions[name]}' for name in names)}"


def main() -> None:
    """Prints a row for each system and Python, with a column for each extra."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--extras", nargs="*", default=["", "all"], help='extras; "" is the package without any')
    extras = parser.parse_args().extras
    print("| System | Python |", " | ".join(f"[{extra}]" if extra else "alone" for extra in extras), "|")
    print("| --- | --- |", " | ".join("---" for _ in extras), "|")
    for system in SYSTEMS:
        for python in PYTHONS:
            cells = (resolved(python, system, extra) for extra in extras)
            print(f"| {system} | {python} |", " | ".join(cells), "|", flush=True)


if __name__ == "__main__":
    main()
