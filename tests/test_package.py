"""The wheel, its metadata, and what must not depend on the extras."""

from __future__ import annotations

import itertools
import os
import pkgutil
import re
import subprocess
import sys
import tomllib
import zipfile
from email.parser import Parser
from importlib.metadata import entry_points, version
from pathlib import Path
from types import ModuleType

import pytest
from packaging.requirements import Requirement

import magical_mj

pytestmark = pytest.mark.xdist_group("wheel")  # which is built once

ROOT = Path(__file__).parent.parent


def canonical(name: str) -> str:
    return name.lower().replace("_", "-")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(folder)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    return zipfile.ZipFile(next(folder.glob("*.whl")))


def test_wheel_holds_the_whole_package(wheel: zipfile.ZipFile) -> None:
    held = set(wheel.namelist())
    files = (path for path in (ROOT / "magical_mj").rglob("*") if path.is_file() and path.parent.name != "__pycache__")
    assert {path.relative_to(ROOT).as_posix() for path in files} <= held
    assert "magical_mj/py.typed" in held
    assert not any(name.startswith(("tests/", "tools/", "methods/", "docs/")) for name in held)


def test_wheel_runs(wheel: zipfile.ZipFile, tmp_path: Path) -> None:
    wheel.extractall(tmp_path)
    code = (
        "import magical_mj; "
        "env = magical_mj.Engine('FindDupe', 'All', seed=1); "
        "assert env.render('ego', 96).any(); "
        "print(magical_mj.__file__)"
    )
    variables = os.environ | {"PYTHONPATH": str(tmp_path)}
    command = [sys.executable, "-c", code]
    result = subprocess.run(command, cwd=tmp_path, env=variables, capture_output=True, text=True, check=False)
    assert result.stderr == ""
    assert Path(result.stdout.strip()).is_relative_to(tmp_path)


def test_wheel_metadata(wheel: zipfile.ZipFile) -> None:
    name = next(name for name in wheel.namelist() if name.endswith(".dist-info/METADATA"))
    metadata = Parser().parsestr(wheel.read(name).decode())
    assert metadata["Version"] == magical_mj.__version__
    assert metadata["Requires-Python"] == ">=3.11"
    requirements = [Requirement(text) for text in metadata.get_all("Requires-Dist", [])]
    base = {
        python: {
            canonical(requirement.name)
            for requirement in requirements
            if requirement.marker is None or requirement.marker.evaluate({"python_version": python, "extra": ""})
        }
        for python in ("3.11", "3.13", "3.14")
    }
    # one of dm_control's dependencies has no wheels from Python 3.13 on
    assert base["3.11"] - base["3.13"] == {"dm-control", "dm-env"}
    assert base["3.13"] == base["3.14"]
    for requirement in requirements:
        assert not re.search("==|~=", str(requirement.specifier)), f"{requirement} is pinned"


def test_constraints_satisfy_the_requirements() -> None:
    lines = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if not line.startswith("#")]
    tested = {canonical(Requirement(line).name): line.split("==")[1] for line in lines}
    content = tomllib.loads((ROOT / "pyproject.toml").read_text())
    project = content["project"]
    extras = itertools.chain.from_iterable(project["optional-dependencies"].values())
    for requirement in map(Requirement, [*project["dependencies"], *extras, *content["dependency-groups"]["dev"]]):
        name = canonical(requirement.name)
        if name not in ("magical-mj", "setuptools"):  # which pip freeze leaves out
            assert requirement.specifier.contains(tested[name]), f"{requirement}, tested with {tested[name]}"


def test_version_is_written_once() -> None:
    assert magical_mj.__version__ == version("magical-mj")
    assert f"version: {magical_mj.__version__}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"## [{magical_mj.__version__}] - " in (ROOT / "CHANGELOG.md").read_text()


def each_in_turn(*programs: str) -> None:
    """Runs programs in one new process, in which the package and Gymnasium are imported anew for each."""
    forget = "for name in [*sys.modules]:\n    if name.startswith(('magical_mj', 'gymnasium')): del sys.modules[name]\n"
    code = "import sys\n" + "".join(f"{forget}{program}\n" for program in programs)
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).stderr == b""


def test_public_modules_can_be_imported_and_are_attributes_of_the_package() -> None:
    names = {
        "actions": "ACTIONS",
        "datasets": "load",
        "demos": "load",
        "evaluation": "EpisodeResult",
        "experts": "Expert",
        "observations": "STATE_NAMES",
        "protocol": "PROTOCOL",
        "shifts": "Shift",
        "wrappers": "ContinuousActions",
    }
    each_in_turn(
        *(
            f"from magical_mj.{module} import {name}; import magical_mj; assert magical_mj.{module}.{name} is {name}"
            for module, name in names.items()
        )
    )


def test_entry_point() -> None:
    (script,) = entry_points(group="console_scripts", name="magical-mj")
    assert script.value == "magical_mj.cli:main"


def test_import_needs_no_extra_and_no_opengl() -> None:
    code = (
        "import sys, magical_mj; from magical_mj.utils.extras import MODULES; "
        "late = {'typer', 'rich', 'numba', 'msgspec', 'imageio_ffmpeg', 'pygame', 'websockets', 'minari', 'h5py'}; "
        "late |= {'lerobot', 'OpenGL', 'dm_control', 'dm_env'}; "
        "print(*(late.union(*MODULES.values()) & sys.modules.keys()))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert result.stderr == ""
    assert result.stdout.split() == []


def test_commands_and_help_load_no_simulator() -> None:
    """Also those of additions. Every command starts with them."""
    code = "import sys; from magical_mj.cli.app import all_commands; all_commands(); print('mujoco' in sys.modules)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.split() == ["False"]


def test_importing_the_package_registers_the_environments_and_leaves_the_import_system_alone() -> None:
    code = (
        "import sys; before = list(sys.meta_path); import magical_mj; import gymnasium; "
        "print(gymnasium.spec('magical_mj/FindDupe-Demo-State-v0').max_episode_steps, sys.meta_path == before)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (result.stdout, result.stderr) == ("100 True\n", "")


def test_any_module_can_be_the_first_one_imported() -> None:
    first = ("envs.presets", "envs.gymnasium_env", "envs.registration", "policies.models")
    spec = "gymnasium.spec('magical_mj/FindDupe-Demo-State-v0')"
    each_in_turn(*(f"import magical_mj.{module}, gymnasium; {spec}" for module in first))


WITHOUT_DM_CONTROL = """
import sys

class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("dm_control", "dm_env", "labmaze", "tree"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Refuse())
import gymnasium, magical_mj
from magical_mj.experts import Expert
from magical_mj.utils.errors import MissingExtraError

env = gymnasium.make("magical_mj/MoveToRegion-TestAll-LoRes4E-v0")
env.reset(seed=0)
ended = False
while not ended:
    *_, ended, info = env.step(env.action_space.sample())
assert 0.0 <= info["eval_score"] <= 1.0

engine = magical_mj.Engine("MoveToRegion", seed=0)
expert = Expert(engine, "MoveToRegion")
while not engine.step(expert()):
    pass
assert engine.score() == 1.0
magical_mj.export_mjcf(engine, "model.xml")
results = magical_mj.evaluate(lambda observation: 1, tasks="MoveToRegion", variants="Demo", episodes=1)
assert len(results) == 1
from magical_mj import *  # names are there, and tell what is missing when they are used
assert not isinstance(engine, magical_mj.Environment)
try:
    load("MoveToRegion")
except MissingExtraError as error:
    assert "dm_control" in str(error) and "MuJoCo 3" in str(error)
else:
    sys.exit("load worked without dm_control")
"""


def test_everything_but_load_works_without_dm_control_and_dm_env(tmp_path: Path) -> None:
    command = [sys.executable, "-c", WITHOUT_DM_CONTROL]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "model.xml").exists()


def test_every_public_name_is_there_and_offered() -> None:
    """In a process in which nothing has been loaded yet."""
    code = (
        "import magical_mj; missing = set(magical_mj.__all__) - set(dir(magical_mj))\n"
        "print(missing, all(getattr(magical_mj, name) is not None for name in magical_mj.__all__))\n"
        "print(hasattr(magical_mj, 'laod'))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set() True\nFalse\n"


def test_every_public_name_is_in_the_api_reference() -> None:
    """By an entry of its own, or among the members of its module."""
    page = "".join(path.read_text("utf-8") for path in (ROOT / "site/pages").glob("api-*.md"))
    shown = []
    for entry in re.finditer(r"\.\. (?:auto|py:)(function|class|data|module):: (\S+)(?:\n   :members:(.*))?", page):
        kind, name, members = entry.groups()
        place, _, last = name.rpartition(".")
        thing = pkgutil.resolve_name(name) if kind == "module" else getattr(pkgutil.resolve_name(place), last)
        shown.append(thing)
        if kind == "module" and members is not None:
            names = re.findall(r"\w+", members) or getattr(thing, "__all__", vars(thing))
            shown += [getattr(thing, each) for each in names]
    modules = (name for name in magical_mj.__all__ if isinstance(getattr(magical_mj, name), ModuleType))
    for place in ("", *(f".{name}" for name in modules), ".learners", ".leaderboard"):
        package = pkgutil.resolve_name(f"magical_mj{place}")
        names = set(package.__all__) - {"__version__"}
        missing = {name for name in names if not any(getattr(package, name) is thing for thing in shown)}
        assert missing == set(), package.__name__
