"""Tests other people's libraries with this package, each in an environment of its own.

    python -m tools.integrations torchrl d3rlpy    (all: every library; turn: two of them, others each day)
    python -m tools.integrations --install lerobot

tests/integrations/libraries.toml says how each library is installed. Its tests are tests/integrations/test_NAME.py.
They record what they trained or compared by pytest's `record_property`, under "compared" and "result". The rows of
docs/integrations.csv and the table of docs/integrations.md are replaced. If a library cannot be installed, its row says
why, unless it has passed before. `turn` writes nothing.
"""

from __future__ import annotations

import argparse
import csv
import datetime as dt
import hashlib
import html
import json
import os
import re
import resource
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

from tools.pages import ROOT, filled, table

LIBRARIES: Final[dict[str, dict[str, Any]]] = tomllib.loads(
    (ROOT / "tests" / "integrations" / "libraries.toml").read_text(encoding="utf-8")
)
FILE: Final = ROOT / "docs" / "integrations.csv"
PAGE: Final = ROOT / "docs" / "integrations.md"
COLUMNS: Final[Sequence[str]] = ("library", "version", "compared", "result", "seconds")
TORCH: Final = "torch==2.13.0"
"""The tested version. Without it, pip may install one with gigabytes for accelerators."""
IN_TURN: Final = 2
LONGEST: Final = 180
"""The CPU seconds that a library's tests may take."""
HANGING: Final = 1200
"""The time limit of tests in seconds."""
LINK: Final = "development.pth"
"""The file that adds the packages of the development environment to a library's own."""

Row = dict[str, str]


class InstallationError(Exception):
    """A library that cannot be installed here."""


def chosen(names: Iterable[str], day: int) -> list[str]:
    """The names of libraries. "all" means every one, and "turn" those of a day."""
    found: list[str] = []
    for name in names:
        if name == "all":
            found += LIBRARIES
        elif name == "turn":
            able = [one for one, library in LIBRARIES.items() if library.get("turn")]
            found += [able[(IN_TURN * day + number) % len(able)] for number in range(IN_TURN)]
        elif name in LIBRARIES:
            found.append(name)
        else:
            sys.exit(f"unknown library {name!r}. There are: {', '.join(LIBRARIES)}, all, turn")
    return list(dict.fromkeys(found))


def python_for(name: str) -> str:
    """The Python for a library's environment: one of the versions that it needs, by default this one.

    Raises:
        InstallationError: if there is none.
    """
    wanted = LIBRARIES[name].get("python")
    if wanted is None:
        return sys.executable
    given = os.environ.get("INTEGRATION_PYTHON")
    for python in filter(shutil.which, [given] if given else [f"python{version}" for version in wanted]):
        asked = [python, "-c", "import sys; print(*sys.version_info[:2], sep='.')"]
        if subprocess.run(asked, capture_output=True, text=True, check=False).stdout.strip() in wanted:
            return python
    versions = " or ".join(wanted)
    raise InstallationError(f"it needs Python {versions}: give INTEGRATION_PYTHON=/path/to/python{wanted[0]}")


def installed(name: str) -> Path:
    """The Python of a library's environment, which is made if it is missing or was made from other requirements.

    Raises:
        InstallationError: if it cannot be made.
    """
    library, folder = LIBRARIES[name], ROOT / f".venv-{name}"
    if missing := library.get("missing"):
        raise InstallationError(missing)
    python, stamp = folder / "bin" / "python", folder / "installed"
    made_of = hashlib.sha256(json.dumps(library, sort_keys=True).encode()).hexdigest()
    if stamp.exists() and stamp.read_text() == made_of:
        return python
    base = python_for(name)
    shutil.rmtree(folder, ignore_errors=True)
    subprocess.run([base, "-m", "venv", str(folder)], check=True)
    if not library.get("own"):
        packages = next(path for path in sys.path if path.endswith("site-packages"))
        next(folder.glob("lib/python*/site-packages")).joinpath(LINK).write_text(f"{packages}\n")
    pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile"]
    for arguments in library["install"]:
        pinned = [] if library.get("own") or "torch==" in arguments else [TORCH]
        done = subprocess.run(
            [*pip, *pinned, *arguments.split()], cwd=ROOT, stderr=subprocess.PIPE, text=True, check=False
        )
        if done.returncode:
            raise InstallationError(done.stderr.strip().splitlines()[-1])
    stamp.write_text(made_of)
    return python


def tested(name: str) -> Row:
    """Installs a library if needed, and runs its tests. Returns its row.

    Raises:
        InstallationError: if it cannot be installed.
        CalledProcessError, TimeoutExpired: if its tests fail.
    """
    library = LIBRARIES[name]
    python = installed(name)
    tests = library.get("tests") or sorted(ROOT.glob(f"tests/integrations/test_{name.replace('-', '_')}*.py"))
    report = ROOT / f".venv-{name}" / "tests.xml"
    command = [str(python), "-m", "pytest", "-q", "-rs", "-p", "no:cacheprovider", "-W", "default"]
    command += ["-m", ""]  # also the tests that otherwise run once a week
    command += [f"--junit-xml={report}", "-o", "junit_family=xunit1"]  # the only family with recorded properties
    variables = {**os.environ, "OMP_NUM_THREADS": "1", "HF_HUB_OFFLINE": "1"}
    before = _cpu_seconds()
    subprocess.run([*command, *map(str, tests)], cwd=ROOT, env=variables, check=True, timeout=HANGING)
    if (seconds := _cpu_seconds() - before) > LONGEST:
        raise subprocess.TimeoutExpired(command, LONGEST)
    version = _printed([str(python), "-c", f"from importlib.metadata import version; print(version({name!r}))"])
    facts = {name: "; ".join(_recorded(report, name)) or library.get(name, "passed") for name in ("compared", "result")}
    return {"library": library["title"], "version": version, **facts, "seconds": f"{seconds:.0f}"}


def _printed(command: Sequence[str]) -> str:
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def _recorded(report: Path, name: str) -> list[str]:
    """The values that tests recorded under this name, in pytest's report."""
    found = re.findall(rf'<property name="{name}" value="(.*?)"', report.read_text(encoding="utf-8"))
    return [html.unescape(value) for value in found]


def _cpu_seconds() -> float:
    """The processor time of all finished child processes. It does not depend on what else the machine does."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def rows() -> list[Row]:
    """The rows of docs/integrations.csv."""
    with FILE.open(newline="", encoding="utf-8") as file:
        return [dict(row) for row in csv.DictReader(file)]


def tables() -> dict[str, str]:
    """The tables of docs/integrations.md by name."""
    head = ("Library", "Version", "Trained or compared", "Result", "CPU s")
    return {"libraries": table(head, [[row[column] for column in COLUMNS] for row in rows()])}


def write(new: Iterable[Row]) -> None:
    """Replaces rows of the file, and the page's table. A row of a library that was not installed replaces no other."""
    known = {row["library"]: row for row in (rows() if FILE.exists() else [])}
    known |= {row["library"]: row for row in new if row["version"] or not known.get(row["library"], row)["version"]}
    titles = [library["title"] for library in LIBRARIES.values()]
    with FILE.open("w", newline="", encoding="utf-8") as file:
        writer: csv.DictWriter[str] = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(known[title] for title in titles if title in known)
    text = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(filled(text, tables(), "make integrations-test"), encoding="utf-8")


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("libraries", nargs="+", help=f"{', '.join(LIBRARIES)}, all or turn")
    parser.add_argument("--install", action="store_true", help="only make the environments")
    options = parser.parse_args()
    done, failed = list[Row](), list[str]()
    for name in chosen(options.libraries, dt.datetime.now(dt.UTC).toordinal()):
        print(f"{name}:", flush=True)
        library = LIBRARIES[name]
        try:
            if "large" in library and name not in options.libraries:
                raise InstallationError(f"{library['large']}: only if it is named")
            if options.install:
                print(installed(name))
            else:
                done.append(tested(name))
        except InstallationError as error:
            done.append(dict.fromkeys(COLUMNS, "") | {"library": library["title"], "result": f"not installed: {error}"})
            print(done[-1]["result"])
            if options.install or not {"large", "missing", "python"} & library.keys():
                failed.append(f"{name}: {error}")
        except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as error:
            failed.append(f"{name}: {error}")
    if not options.install and "turn" not in options.libraries:
        write(done)
    if failed:
        sys.exit("\n".join(failed))


if __name__ == "__main__":
    main()
