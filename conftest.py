"""Imported before any test module: mujoco looks at MUJOCO_GL when it is imported, for its own renderer.

The tests' temporary files lie in a folder of their own, which goes when all is well: a test, or the code that it runs,
that leaves something behind makes the tests fail, and the system's folder stays as it was.
"""

import gc
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest

os.environ.setdefault("OMP_NUM_THREADS", "1")  # PyTorch's: several tests run at once, and its threads wait busily

if sys.platform == "linux":
    os.environ.setdefault("MUJOCO_GL", "egl")

import magical_mj
from magical_mj.rendering.backend import load_triton
from tests.helpers.commands import Shell
from tests.helpers.entries import EPISODES

load_triton()  # before test modules import dm_control, which loads a driver

MAY_STAY = ("pytest-of-*", "torchinductor_*", ".ses", "wp_pch_*")
"""What pytest keeps of failing tests, PyTorch makes at the first use of an optimiser, ONNX Runtime at import, and Warp
when it compiles a kernel: headers, which it keeps until the process ends."""
FOLDER = pytest.StashKey[Path]()


def pytest_configure(config: pytest.Config) -> None:
    # Shells let what they start in the background ignore Ctrl-C; the tests' own processes would inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if hasattr(config, "workerinput"):  # one of several processes, which has the folder from the first
        return
    folder = Path(tempfile.mkdtemp(prefix="magical-mj-"))
    config.stash[FOLDER] = folder
    os.environ["TMPDIR"] = os.environ["RAY_TMPDIR"] = tempfile.tempdir = str(folder)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Garbage is looked for less often, and never among the modules and tests: a million objects that stay."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(100_000, 5, 5)  # by default, the search takes a fifth of the time of a test with many objects
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Slow tests come first, so that all processes end together."""
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_sessionfinish(session: pytest.Session) -> Generator[None, None, None]:
    yield
    folder = session.config.stash.get(FOLDER, None)
    if folder is None:
        return
    left = {path.name for path in folder.iterdir()} - {path.name for name in MAY_STAY for path in folder.glob(name)}
    if left:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
    if session.exitstatus in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED):
        shutil.rmtree(folder)
    else:
        reason = f"; left behind, though it should be gone: {', '.join(sorted(left))}" if left else ""
        session.config.get_terminal_writer().line(f"\n\ntemporary files are in {folder}{reason}")


@pytest.fixture
def shell(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Shell:
    """Runs `magical-mj` in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return Shell(capsys)


@pytest.fixture(autouse=True)
def forgotten_modules(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """After each test, the modules that it has written are forgotten: others write modules of the same names."""
    before = set(sys.modules)
    yield
    written = str(tmp_path_factory.getbasetemp())
    for name in sys.modules.keys() - before:
        if (getattr(sys.modules[name], "__file__", None) or "").startswith(written):
            del sys.modules[name]


@pytest.fixture(scope="session")
def evaluated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A few episodes of the expert, who is right everywhere, so that nobody else's actions would be."""
    out = tmp_path_factory.mktemp("evaluated") / "expert"
    magical_mj.evaluate("expert", tasks="MoveToRegion", variants="Layout", episodes=EPISODES, out=out)
    return out


@pytest.fixture
def folder(evaluated: Path, tmp_path: Path) -> Path:
    """A copy of that evaluation, to tamper with."""
    return Path(shutil.copytree(evaluated, tmp_path / "expert"))
