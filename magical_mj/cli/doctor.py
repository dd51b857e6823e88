"""`magical-mj doctor`: installed versions, and the renderers that work on this machine."""

from __future__ import annotations

import json
import os
import platform
import re
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, requires, version
from typing import Any, Final

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from magical_mj.cli.console import console
from magical_mj.cli.probe import SIZE
from magical_mj.rendering.backend import PACKAGES, REMEDY, VARIABLE, drawn_by, wanted_backend
from magical_mj.utils.extras import remedy

CORE: Final = ("magical-mj", "mujoco", "gymnasium", "numpy", "shapely", "pillow")
OWN: Final = ("all", "dev", "site")
"""Extras that combine others, or are for development of the package."""
REQUIREMENT: Final = re.compile(r"([\w.-]+).*;.*\bextra == ['\"]([\w-]+)['\"]")
"""A requirement of an extra in the package's metadata."""
BACKENDS: Final = ("egl", "osmesa", "glfw")  # only the last needs a display
SOFTWARE: Final = "software"
TIMEOUT: Final = 180  # seconds for one renderer; the software renderer may have to be compiled


def doctor() -> None:
    """Show installed versions, test the software renderer and all OpenGL backends, and name the one in use."""
    out = console()
    used, wanted = drawn_by() or "glfw", wanted_backend()
    _print_versions(out)
    results = {name: _probe(name) for name in dict.fromkeys((*BACKENDS, wanted or "egl", SOFTWARE))}
    _print_results(out, results)
    times = {name: facts["typical"] for name, facts in results.items() if "error" not in facts}
    if not times:
        out.print(f"\nNo renderer works here. Physics and states work without one. {REMEDY}", style="bold red")
        raise typer.Exit(1)
    fastest, setting = min(times, key=times.__getitem__), os.environ.get(VARIABLE) or "not set"
    out.print(f"\nFlat views are drawn by {used} ({VARIABLE} is {setting}); the fastest here: {fastest}.")
    backends = [name for name in times if name != SOFTWARE]
    if not backends:
        out.print(f"OpenGL does not work. The view `scene` and models that users have changed need it. {REMEDY}")
    if wanted and wanted not in backends:
        other = f"unset it, or set MUJOCO_GL={backends[0]}" if backends else "unset it"
        out.print(f"MUJOCO_GL={wanted} is set, but that backend does not work; {other}", style="bold red")
    if used not in times or wanted not in ("", *backends):
        raise typer.Exit(1)


def _print_versions(out: Console) -> None:
    table = Table.grid(padding=(0, 2))
    table.add_row("python", f"{platform.python_version()}, {platform.platform()}")
    for name in CORE:
        table.add_row(name, _version(name) or Text("missing", style="red"))
    table.add_row("dm_control", _version("dm_control") or "not installed: only magical_mj.load needs it")
    for name, extra in optional().items():
        table.add_row(name, _version(name) or f"not installed: {remedy(extra)}")
    table.add_row("MUJOCO_GL", os.environ.get("MUJOCO_GL") or "not set")
    out.print(table)


def optional() -> dict[str, str]:
    """Package -> the smallest extra that includes it, from the metadata of magical-mj."""
    extras: dict[str, list[str]] = {}
    for requirement in (requires("magical-mj") or []) if _version("magical-mj") else []:
        if match := REQUIREMENT.match(requirement):
            extras.setdefault(match[2], []).append(match[1])
    packages: dict[str, str] = {}
    for extra in sorted(extras.keys() - OWN, key=lambda extra: (len(extras[extra]), extra)):
        for name in extras[extra]:
            packages.setdefault(name, extra)
    return packages


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _probe(name: str) -> dict[str, Any]:
    """Runs `magical_mj.cli.probe` with an OpenGL backend or the software renderer. Returns its JSON, or the error."""
    command = [sys.executable, "-m", "magical_mj.cli.probe"]
    variables = {name: value for name, value in os.environ.items() if name != "PYOPENGL_PLATFORM"}
    variables |= {VARIABLE: SOFTWARE} if name == SOFTWARE else {VARIABLE: "opengl", "MUJOCO_GL": name}
    alive, ours = os.pipe()  # closes when this process ends, even if it is killed
    try:
        result = subprocess.run(
            command, env=variables, stdin=alive, capture_output=True, text=True, timeout=TIMEOUT, check=False
        )
    except subprocess.TimeoutExpired:
        return {"error": f"no answer within {TIMEOUT} s"}
    finally:
        os.close(alive)
        os.close(ours)
    if result.returncode == 0:
        return json.loads(result.stdout)
    last_line = (result.stderr.strip().splitlines() or [f"exit code {result.returncode}"])[-1]
    problem = last_line.removeprefix("magical_mj.utils.errors.RenderingError: ").removesuffix(REMEDY).strip()
    needed = f" (Debian and Ubuntu packages: {PACKAGES[name]})" if name in PACKAGES else ""
    return {"error": f"{problem.rstrip('.')}{needed}"}


def _print_results(out: Console, results: dict[str, dict[str, Any]]) -> None:
    table = Table("", "", "renderer", "first frame", f"{SIZE} px frame", box=None, header_style="bold")
    for name, facts in results.items():
        if "error" in facts:
            table.add_row(name, Text("fails", style="red"))
        else:
            times = [f"{facts[time]:.1f} ms" for time in ("first", "typical")]
            table.add_row(name, Text("works", style="green"), facts["renderer"], *times)
    out.print()
    out.print(table)
    if "error" not in results[SOFTWARE]:
        kept = results[SOFTWARE]["code"]
        where = f"which {kept} keeps" if kept else "in each process: numba's cache has no folder that it can write to"
        out.print(f"The software renderer's first frame includes its compilation, {where}.", soft_wrap=True)
    for name, facts in results.items():
        if "error" in facts:  # an error may be too long for the table
            out.print(f"{name}: {facts['error']}", soft_wrap=True)
