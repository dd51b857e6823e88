"""Where evaluations are played: the same scores on clusters and in several processes as here, when one dies."""

from __future__ import annotations

import os
import signal
import sys
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import magical_mj
from magical_mj.evaluation import EpisodeResult
from magical_mj.evaluation.scores import read
from magical_mj.utils.errors import EvaluationError, MissingExtraError, SettingsError
from magical_mj.utils.parallel import map_unordered

SETTINGS: dict[str, Any] = {"tasks": "MoveToRegion", "variants": "Demo,Layout", "episodes": 12}


def rows(scores: list[EpisodeResult]) -> list[Any]:
    return sorted((score.key, score.score, score.actions, score.failure) for score in scores)


def who(_: int) -> tuple[int, float, float]:
    """The process, and when it worked."""
    begun = time.monotonic()
    time.sleep(0.1)
    return os.getpid(), begun, time.monotonic()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of the libraries' own
def test_dask_works_on_the_cluster_and_survives_the_loss_of_a_worker(tmp_path: Path) -> None:
    """On no more pieces at once than asked for; one of two workers is killed when the first scores come in."""
    distributed = pytest.importorskip("distributed")
    magical_mj.evaluate("random,Slow=noop", out=tmp_path / "here", **SETTINGS)  # does the same, but faster
    killed: list[int] = []
    here = distributed.dask.config.set({"temporary-directory": str(tmp_path)})  # it leaves a folder wherever that is
    with (
        here,
        distributed.LocalCluster(
            n_workers=2,
            threads_per_worker=1,
            dashboard_address=None,
            env={"PYTHONPATH": str(Path(__file__).parents[2])},
        ) as cluster,
    ):
        address = cluster.scheduler_address
        for jobs, together in ((1, False), (None, True)):
            pieces = sorted(map_unordered(who, range(6), jobs, "dask", address), key=lambda piece: piece[1])
            assert len(pieces) == 6
            assert {pid for pid, _, _ in pieces} <= {nanny.process.pid for nanny in cluster.workers.values()}
            assert any(first[2] > second[1] for first, second in pairwise(pieces)) == together

        def kill_one(_: EpisodeResult) -> None:
            if not killed:
                killed.append(next(iter(cluster.workers.values())).process.pid)
                os.kill(killed[0], signal.SIGKILL)

        magical_mj.evaluate(
            "random,tests.helpers.agents:Slow",
            out=tmp_path / "there",
            jobs=None,
            backend="dask",
            address=address,
            watch=kill_one,
            **SETTINGS,
        )
    assert killed
    assert rows(read(tmp_path / "there")) == rows(read(tmp_path / "here"))


@pytest.mark.filterwarnings("ignore")
def test_dask_cluster_without_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr("magical_mj.utils.parallel.PATIENCE", 0.1)
    with (
        distributed.dask.config.set({"temporary-directory": str(tmp_path)}),
        distributed.LocalCluster(n_workers=0, dashboard_address=None) as cluster,
        pytest.raises(EvaluationError, match="the dask cluster has no workers: start some with `dask worker tcp"),
    ):
        magical_mj.evaluate("noop", backend="dask", address=cluster.scheduler_address, **SETTINGS)


@pytest.mark.filterwarnings("ignore")
def test_a_cluster_that_is_not_there(tmp_path: Path) -> None:
    """What is no address is said before anything is made."""
    distributed = pytest.importorskip("distributed")
    with distributed.dask.config.set({"distributed.comm.timeouts.connect": "1s"}):
        for address in ("tcp://127.0.0.1:9", "foo://127.0.0.1:9"):
            with pytest.raises(EvaluationError, match=rf"no dask scheduler answers at {address}"):
                magical_mj.evaluate("noop", backend="dask", address=address, **SETTINGS)
    for address in ("localhost", "tcp://h:notaport", "tcp://h", "http://h:1/path"):
        with pytest.raises(SettingsError, match="needs the scheduler's address"):
            magical_mj.evaluate("noop", backend="dask", address=address, out=tmp_path / "out", **SETTINGS)
    assert not (tmp_path / "out").exists()


def test_a_dead_worker_is_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its unit is played again; so the scores are those of an evaluation in which nobody died."""
    mark = tmp_path / "mark"
    monkeypatch.setenv("FATAL_MARK", str(mark))
    frame = magical_mj.evaluate("tests.helpers.agents:Fatal", jobs=2, out=tmp_path / "dying", **SETTINGS)
    assert mark.exists()
    assert isinstance(frame, pd.DataFrame)
    assert frame["seed"].tolist() == 2 * list(range(SETTINGS["episodes"]))
    magical_mj.evaluate("tests.helpers.agents:Fatal", jobs=1, out=tmp_path / "living", **SETTINGS)
    assert rows(read(tmp_path / "dying")) == rows(read(tmp_path / "living"))


def test_a_policy_that_kills_every_worker_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mark").write_text("always")
    monkeypatch.setenv("FATAL_MARK", str(tmp_path / "mark"))
    with pytest.raises(EvaluationError, match=r"3 worker processes died .*SIGKILL.* --resume continues"):
        magical_mj.evaluate("tests.helpers.agents:Fatal", jobs=2, **SETTINGS)


def test_missing_extras_are_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingExtraError, match=r"\[dask\]"):
        magical_mj.evaluate("noop", backend="dask", address="tcp://127.0.0.1:9", **SETTINGS)
    monkeypatch.setattr("magical_mj.utils.extras.find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"pip install .*\[eval\]"):
        magical_mj.evaluate("noop", **SETTINGS)
