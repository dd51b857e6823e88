"""Evaluations in batched environments: approximate, marked, and no official results; on Warp's CPU device."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

import magical_mj
from magical_mj import batched
from magical_mj.batched.environment import Arrays
from magical_mj.evaluation import Episode, rollouts
from magical_mj.evaluation.folder import SETTINGS
from magical_mj.evaluation.reports.report import report
from magical_mj.evaluation.scores import read
from magical_mj.leaderboard import submit, verify
from magical_mj.utils.errors import EvaluationError, SettingsError
from tests.helpers.entries import rewrite

pytestmark = [pytest.mark.xdist_group("warp"), pytest.mark.filterwarnings("default")]

BATCHED = {"simulator": "warp", "device": "cpu", "preset": "State", "episodes": 2}
ONE = {"tasks": "MoveToRegion", "variants": "Demo"}


class Demonstrator:
    """Acts as the first demonstration, and looks at observations."""

    def reset_batch(self, episodes: Any) -> None:
        self.count, self.step = len(episodes), 0

    def act_batch(self, observations: NDArray[np.float32]) -> NDArray[np.int64]:
        assert isinstance(observations, np.ndarray)
        assert observations.shape[0] == self.count
        self.step += 1
        return np.full(self.count, magical_mj.demos.load("MoveToRegion")[0].actions[self.step - 1])

    def __call__(self, observation: NDArray[np.float32]) -> int:
        return int(self.act_batch(observation[None])[0])


class Failing(Demonstrator):
    """Fails in the episode of seed 1, and in all that are played beside it."""

    def reset_batch(self, episodes: Any) -> None:
        super().reset_batch(episodes)
        if any(episode.seed == 1 for episode in episodes):
            raise ValueError("no")


@pytest.fixture
def official(tmp_path: Path) -> Path:
    magical_mj.evaluate("noop", **ONE, episodes=2, run=1, out=tmp_path / "official")
    return tmp_path / "official"


@pytest.fixture
def approximate(tmp_path: Path) -> Path:
    """Marked as if it had been played in batched environments, which would take longer."""
    out = tmp_path / "approximate"
    magical_mj.evaluate("noop", **ONE, episodes=2, out=out)
    rewrite(out, lambda rows: [row.update(worlds="batched") for row in rows])
    settings = json.loads((out / SETTINGS).read_text())
    (out / SETTINGS).write_text(json.dumps({**settings, "worlds": "batched"}))
    return out


def test_scores_are_those_of_the_episodes_and_marked(tmp_path: Path) -> None:
    """A failure costs its own episode only: the other one is played again."""
    out = tmp_path / "played"
    magical_mj.evaluate({"demonstrator": Failing()}, **BATCHED, **ONE, out=out)
    played, failed = read(out)
    assert (played.score, played.steps, played.worlds, played.failure) == (1.0, 40, "batched", None)
    assert (failed.score, failed.steps, failed.worlds) == (0.0, 0, "batched")
    assert str(failed.failure).startswith("ValueError: no")
    assert json.loads((out / SETTINGS).read_text())["worlds"] == "batched"


def test_a_world_that_breaks_is_a_failure() -> None:
    env = batched.make("MoveToRegion", "Demo", 2, device="cpu", preset="State", autoreset_mode=AutoresetMode.DISABLED)

    def breaking(_: Any) -> int:
        env.physics.state["qvel"][1] = float("nan")
        return 0

    outcomes = list(rollouts(Arrays(env), breaking, [Episode("MoveToRegion", "Demo", seed, 0) for seed in (0, 1)]))
    assert [outcome.failure for outcome in outcomes] == 2 * [
        "PhysicsError: the state of a simulation is not finite any more"
    ]
    assert [outcome.score for outcome in outcomes] == [0.0, 0.0]
    env.close()


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({**BATCHED, "device": "cuda:7"}, "no device 'cuda:7'"),
        (BATCHED, "noop uses no observations"),
    ],
)
def test_settings_that_batches_do_not_support_are_refused(settings: dict[str, Any], says: str) -> None:
    policy = "noop" if settings is BATCHED else {"demonstrator": Demonstrator()}
    with pytest.raises(SettingsError, match=says):
        magical_mj.evaluate(policy, **settings, **ONE)


def test_batched_evaluations_cannot_be_entries(approximate: Path, tmp_path: Path) -> None:
    findings = verify(approximate, jobs=1)
    assert "batched environments" in findings.unfit[0]
    assert not findings.good
    with pytest.raises(EvaluationError, match=r"cannot be an entry.*batched environments"):
        submit([approximate], tmp_path / "entry.json.xz")
    assert not (tmp_path / "entry.json.xz").exists()


def test_reports_say_so_and_hold_nothing_else(approximate: Path, official: Path, tmp_path: Path) -> None:
    page = report([approximate], tmp_path / "report").read_text()
    assert page.startswith("# Evaluation\n\n**Approximate, no official results: ")
    assert "Approximate" not in report([official], tmp_path / "other").read_text()
    with pytest.raises(EvaluationError, match=r"different worlds: .*report them separately"):
        report([approximate, official], tmp_path / "both", mixed_presets=True)


def test_an_evaluation_goes_on_in_the_same_worlds_only(approximate: Path, official: Path) -> None:
    with pytest.raises(SettingsError, match='worlds was "batched" and is "single"'):
        magical_mj.evaluate("noop", **ONE, episodes=2, out=approximate, resume=True)
    settings = json.loads((official / SETTINGS).read_text())
    settings.pop("worlds")  # as older versions left them
    (official / SETTINGS).write_text(json.dumps(settings))
    rewrite(official, lambda rows: [row.pop("worlds") for row in rows])
    assert len(magical_mj.evaluate("noop", **ONE, episodes=2, run=1, out=official, resume=True)) == 2
