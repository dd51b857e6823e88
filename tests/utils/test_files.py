"""Files are written as a whole or not at all, and never replaced unasked."""

from __future__ import annotations

import errno
import multiprocessing
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import pytest

from magical_mj import Robot, Scene, demos, export_mjcf, leaderboard
from magical_mj.evaluation.reports.report import report
from magical_mj.learners import load_policy, plan_experiment
from magical_mj.utils import files
from magical_mj.utils.errors import SettingsError

BYTES: Final[Any] = b"a path"


@pytest.mark.parametrize("data", ["äö\n", b"\x00\xff", ""])
def test_written_content_is_read_back(tmp_path: Path, data: str | bytes) -> None:
    files.write(tmp_path / "a.txt", data)
    assert (tmp_path / "a.txt").read_bytes() == (data.encode() if isinstance(data, str) else data)
    assert list(tmp_path.iterdir()) == [tmp_path / "a.txt"]


def test_nothing_is_replaced_unasked(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    files.write(path, "one")
    with pytest.raises(FileExistsError, match="exists already; give another path, or remove it") as caught:
        files.write(path, "two")
    assert caught.value.filename == str(path)
    assert path.read_text() == "one"
    files.write(path, "two", overwrite=True)
    assert path.read_text() == "two"
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_that_appears_meanwhile_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"

    def slowly() -> None:
        with files.new_file(path) as beside:
            beside.write_text("mine")
            path.write_text("theirs")

    with pytest.raises(FileExistsError):
        slowly()
    assert path.read_text() == "theirs"
    assert list(tmp_path.iterdir()) == [path]


def test_a_program_that_fails_leaves_nothing(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    path.write_bytes(b"before")

    def fail() -> None:
        with files.new_file(path, overwrite=True) as beside:
            assert beside.suffix == ".mp4"
            beside.write_bytes(b"half")
            raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        fail()
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


def test_errors_name_the_file(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="nowhere") as caught:
        files.write(tmp_path / "nowhere" / "a.txt", "x")
    assert caught.value.filename == str(tmp_path / "nowhere" / "a.txt")


def test_a_link_leads_to_the_new_content(tmp_path: Path) -> None:
    """Whoever put a large file elsewhere wants it to stay there."""
    (tmp_path / "large").mkdir()
    (tmp_path / "large" / "file").write_text("old")
    (tmp_path / "link").symlink_to(tmp_path / "large" / "file")
    files.write(tmp_path / "link", "new", overwrite=True)
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "large" / "file").read_text() == "new"
    with pytest.raises(FileExistsError):
        files.write(tmp_path / "link", "newer")


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_folder_is_not_accepted_as_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, overwrite: bool) -> None:
    monkeypatch.chdir(tmp_path)
    for folder in (".", "..", tmp_path):
        with pytest.raises(IsADirectoryError, match="is a folder"):
            files.write(folder, "x", overwrite=overwrite)
    assert not list(tmp_path.iterdir())


def test_a_full_disk_names_the_file_and_leaves_nothing(tmp_path: Path) -> None:
    """A process that may write no more than 1 kB, as if the disk were full."""
    program = (
        "import resource, signal, sys\n"
        "from magical_mj.utils import files\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        "try:\n"
        "    files.write(sys.argv[1], b'x' * 10_000, overwrite=True)\n"
        "except OSError as error:\n"
        "    print(error.errno, error.filename)\n"
    )
    path = tmp_path / "a.bin"
    path.write_bytes(b"before")
    command = [sys.executable, "-c", program, str(path)]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    assert result.stdout == f"{errno.EFBIG} {path}\n"
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


def test_writers_take_turns_and_what_a_killed_one_left_goes_with_the_next(tmp_path: Path) -> None:
    program = (
        "import sys\n"
        "from magical_mj.utils import files\n"
        "print('ready', flush=True)\n"
        "with files.new_file(sys.argv[1]) as unfinished:\n"
        "    unfinished.write_text(sys.argv[2])\n"
        "    print('written', flush=True)\n"
        "    sys.stdin.readline()\n"
    )
    path = tmp_path / "a[1].txt"
    processes = []
    for text, lines in (("half", ("ready", "written")), ("whole", ("ready",))):
        process = subprocess.Popen(
            [sys.executable, "-c", program, str(path), text], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        for line in lines:
            assert process.stdout.readline() == f"{line}\n"
        processes.append(process)
    first, second = processes
    assert len(list(tmp_path.iterdir())) == 2
    assert all(map(files.is_unfinished, tmp_path.iterdir()))
    first.kill()
    first.communicate()
    second.communicate("\n")
    assert second.returncode == 0
    assert list(tmp_path.iterdir()) == [path]
    assert path.read_text() == "whole"


def test_files_are_flushed_as_windows_allows_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """There, `os.fsync` takes only what is open for writing."""
    fcntl = pytest.importorskip("fcntl")
    flush = os.fsync

    def flush_as_windows(descriptor: int) -> None:
        if fcntl.fcntl(descriptor, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDONLY:
            raise OSError(errno.EBADF, "Bad file descriptor")
        flush(descriptor)

    monkeypatch.setattr(os, "fsync", flush_as_windows)
    files.write(tmp_path / "a.txt", "text")
    assert (tmp_path / "a.txt").read_text() == "text"


def test_long_names_and_modes(tmp_path: Path) -> None:
    path = tmp_path / f"{'ä' * 125}.txt"  # 254 bytes
    files.write(path, "secret", mode=0o600)
    assert list(tmp_path.iterdir()) == [path]
    assert path.stat().st_mode & 0o777 == 0o600


def test_files_of_others_are_plain_and_of_bounded_size(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"12345")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("/dev/zero")
    assert files.read_foreign(tmp_path / "file", most=5, error=SettingsError) == b"12345"
    with pytest.raises(SettingsError, match="larger than 4 bytes"):
        files.read_foreign(tmp_path / "file", most=4, error=SettingsError)
    for name in ("pipe", "link", "."):
        with pytest.raises(SettingsError, match="not a plain file"):
            files.read_foreign(tmp_path / name, most=5, error=SettingsError)
    with pytest.raises(FileNotFoundError):
        files.read_foreign(tmp_path / "nothing", most=5, error=SettingsError)
    with pytest.raises(SettingsError, match="not a plain file"):
        files.read_toml(tmp_path / "pipe")


def test_writers_may_change_the_working_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a policy that is played does; relative paths are those of the beginning, and errors name what was given."""
    (tmp_path / "elsewhere").mkdir()
    for name in ("a.txt", "set", "lock"):
        monkeypatch.chdir(tmp_path)
        if name == "lock":
            with files.locked(Path()):
                monkeypatch.chdir("elsewhere")
            continue
        with (files.new_file if name == "a.txt" else files.new_folder)(Path(name)) as unfinished:
            monkeypatch.chdir("elsewhere")
            unfinished.write_text("text")
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["a.txt", "elsewhere", "set"]
    monkeypatch.chdir(tmp_path)
    for make in (files.new_file, files.new_folder):
        with pytest.raises(FileExistsError) as caught, make(Path("a.txt")):
            pytest.fail("nothing is replaced unasked")
        assert caught.value.filename == "a.txt"


def test_a_folder_is_replaced_as_a_whole_or_not_at_all(tmp_path: Path) -> None:
    path, text = tmp_path / "new" / "set", "one"
    for text in ("one", "two"):
        with files.new_folder(path, overwrite=True) as unfinished:
            unfinished.mkdir()
            (unfinished / text).touch()
    with pytest.raises(FileExistsError), files.new_folder(path):
        pytest.fail("nothing is replaced unasked")
    with pytest.raises(FileNotFoundError), files.new_folder(path, overwrite=True) as unfinished:
        (unfinished / "without" / "its" / "parent").mkdir()
    assert [file.name for file in path.iterdir()] == ["two"]
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize(
    ("left", "there"),
    [
        (["part"], []),  # killed while it made a new one
        (["set", "part"], ["set"]),  # killed while it made one to replace this one
        (["part", "old"], ["old"]),  # killed before it had renamed it
        (["set", "old"], ["set"]),  # killed after that; or somebody has made another one by now, which counts
    ],
)
def test_a_process_that_died_costs_no_folder(left: list[str], there: list[str], tmp_path: Path) -> None:
    path = tmp_path / "set"
    for name in left:
        folder = path if name == "set" else tmp_path / f".set.{name}"
        folder.mkdir()
        (folder / name).touch()
    with pytest.raises(KeyboardInterrupt), files.new_folder(path, overwrite=True):
        raise KeyboardInterrupt
    assert [file.name for file in path.glob("*")] == there
    assert list(tmp_path.iterdir()) == [path] * len(there)


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="only Linux has /proc")
def test_where_no_file_can_be_created_nothing_waits() -> None:
    for make in (files.new_file, files.new_folder):
        with pytest.raises(FileNotFoundError, match="No such file"), make(Path("/proc/new")):
            pytest.fail("nothing can be written here")
    with pytest.raises(FileNotFoundError), files.locked(Path("/proc")):
        pytest.fail("the lock was not created")


def test_a_lock_is_for_one_at_a_time_and_ends_with_its_context(tmp_path: Path) -> None:
    """Although a child that was forked meanwhile lives on, and holds the same descriptor."""
    (tmp_path / "a.txt").write_text("text")
    busy = ValueError("busy")
    for path in (tmp_path, tmp_path / "a.txt"):
        child = multiprocessing.get_context("fork").Process(target=time.sleep, args=(60,), daemon=True)
        with files.locked(path):
            child.start()
            with pytest.raises(ValueError, match="busy"), files.locked(path, busy=busy):
                pytest.fail("two are in it")
        with files.locked(path, busy=busy):
            assert child.is_alive()
        child.kill()
        child.join()
    assert (tmp_path / "a.txt").read_text() == "text"


@pytest.mark.parametrize(
    "call",
    [
        lambda: demos.read(BYTES),
        lambda: export_mjcf(Scene(Robot(0, 0, 0)), BYTES),
        lambda: leaderboard.submit([BYTES], "entry.json.xz"),
        lambda: leaderboard.read_entry(BYTES),
        lambda: leaderboard.verify(BYTES),
        lambda: report([BYTES], "report"),
        lambda: plan_experiment(BYTES, "runs"),
        lambda: load_policy(BYTES),
    ],
)
def test_arguments_that_are_not_paths_are_refused(call: Callable[[], object]) -> None:
    with pytest.raises(SettingsError, match="a path must be"):
        call()
