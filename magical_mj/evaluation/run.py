"""Evaluations: what is asked for, what is already done, and doing the rest."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import mujoco

from magical_mj._version import __version__
from magical_mj.errors import EvaluationError, SettingsError, unknown_name
from magical_mj.evaluation.backends import check_backend, play_units
from magical_mj.evaluation.loading import sources
from magical_mj.evaluation.policies import check_fit
from magical_mj.evaluation.scores import Score, ScoreFile, frame, prepare
from magical_mj.evaluation.worker import plan
from magical_mj.extras import check_extra
from magical_mj.presets import preset as check_preset
from magical_mj.registry import Names, check_rules, environments
from magical_mj.tasks.spec import Rules

if TYPE_CHECKING:
    import pandas as pd

EPISODES: Final = 100
"""As many as the paper's."""
TIME_LIMIT: Final = 300.0
"""Seconds for one episode: many times what any episode takes with a policy that answers at all."""


def evaluate(
    policy: Any,
    *,
    tasks: Names = "all",
    variants: Names = "all",
    episodes: int = EPISODES,
    preset: str = "LoRes4E",
    rules: str = "paper",
    out: Path | str | None = None,
    resume: bool = False,
    jobs: int | None = 1,
    backend: str = "local",
    address: str | None = None,
    run: int = 0,
    time_limit: float = TIME_LIMIT,
    envs: int = 1,
    vectorization: str = "sync",
    trust: bool = False,
    watch: Callable[[Score], None] = lambda _: None,
) -> pd.DataFrame:
    """Plays a policy's episodes in the evaluation scenes of some environments, and returns all scores.

    Args:
        policy: "expert", "random", "noop", "module:object", the folder of a training, a model file (.zip of
            stable-baselines3, .onnx), a `Policy`, or a function from observation to action; or several, as a list or
            as a mapping of names to them. Those of the same name are successive runs of one method.
        tasks: the tasks, as a list or separated by commas; "all" is all 8.
        variants: the variants, likewise; pairs that do not exist are left out.
        episodes: how many in each environment: those of the scenes of seeds 0, 1, ...
        preset: the observations that the policy is given, one of `magical_mj.presets.PRESETS`.
        rules: "paper", or "released" for the scores and horizons of the original's released code.
        out: a folder for the scores; None: they are only returned.
        resume: go on with what is in the folder.
        jobs: how many processes work; None: one for each core, or as many as the cluster has.
        backend: "local", "dask" or "ray".
        address: of the cluster.
        run: the number of the (first) run, to tell apart several trained policies of one method.
        time_limit: for one episode, in seconds.
        envs: how many episodes each process plays side by side, in a vector environment.
        vectorization: of the vector environment: "sync", or "async" for a process each.
        trust: load model files that hold code.
        watch: called with each episode that ends.

    Returns:
        A pandas frame with a row for each episode: see `magical_mj.evaluation.Score`.

    Raises:
        SettingsError, UnknownNameError: if something that is asked for does not exist, or was different before.
        EvaluationError: if the folder holds something else, a worker dies, or an extra is not installed.
    """
    check_extra("evaluations", "eval")
    check_backend(backend, jobs, address)
    evaluation = Evaluation(
        policy,
        tasks=tasks,
        variants=variants,
        episodes=episodes,
        preset=preset,
        rules=rules,
        out=out,
        resume=resume,
        run=run,
        time_limit=time_limit,
        envs=envs,
        vectorization=vectorization,
        trust=trust,
    )
    for score in evaluation.play(jobs, backend, address):
        watch(score)
    return frame(evaluation.scores)


class Evaluation:
    """What `evaluate` does, in steps: prepare, then play. Its arguments are those of `evaluate`.

    Attributes:
        rules: by which scores are given.
        scores: of the episodes that are done.
        units: what is left to do when it starts.
    """

    def __init__(
        self,
        policy: Any,
        *,
        tasks: Names = "all",
        variants: Names = "all",
        episodes: int = EPISODES,
        preset: str = "LoRes4E",
        rules: str = "paper",
        out: Path | str | None = None,
        resume: bool = False,
        run: int = 0,
        time_limit: float = TIME_LIMIT,
        envs: int = 1,
        vectorization: str = "sync",
        trust: bool = False,
    ) -> None:
        """Checks everything and reads what is done; plays nothing yet."""
        pairs = environments(tasks, variants)
        check_preset(preset)
        for what, number in (("episodes", episodes), ("envs", envs), ("time_limit", time_limit)):
            if not number > 0:
                raise SettingsError(f"{what} must be positive, not {number}")
        if vectorization not in ("sync", "async"):
            raise unknown_name("vectorization", vectorization, ("sync", "async"))
        listed = sources(policy, run, trust)
        for source in listed:
            check_fit(source.load(), pairs, preset)  # so that what is wrong with it is said now
        self.rules: Rules = check_rules(rules)
        self._out = None if out is None else Path(out)
        self._settings = {
            "policies": [source.describe() for source in listed],
            "environments": [f"{task}-{variant}" for task, variant in pairs],
            "episodes": episodes,
            "preset": preset,
            "rules": self.rules,
            "time_limit": time_limit,
            "version": __version__,
            "mujoco": mujoco.__version__,
            "gl": os.environ.get("MUJOCO_GL", ""),
        }
        self.scores = [] if self._out is None else prepare(self._out, self._settings, resume)
        self.units = plan(
            listed,
            pairs,
            episodes,
            {score.key for score in self.scores},
            preset=preset,
            rules=self.rules,
            time_limit=time_limit,
            envs=envs,
            vectorization=vectorization,
        )

    def play(self, jobs: int | None = 1, backend: str = "local", address: str | None = None) -> Iterator[Score]:
        """Plays what is left and yields each score once it is in the file."""
        if self._out is None:
            yield from self._play(None, jobs, backend, address)
        else:
            with ScoreFile(self._out) as file:
                yield from self._play(file, jobs, backend, address)

    def _play(self, file: ScoreFile | None, jobs: int | None, backend: str, address: str | None) -> Iterator[Score]:
        for found in play_units(self.units, backend, jobs, address):
            for score in found:
                if (score.version, score.mujoco) != (__version__, mujoco.__version__):
                    raise EvaluationError(
                        f"a worker has magical_mj {score.version} and mujoco {score.mujoco}, "
                        f"and this process {__version__} and {mujoco.__version__}: install the same everywhere"
                    )
            if file is not None:
                file.add(found)
            self.scores += found
            yield from found
