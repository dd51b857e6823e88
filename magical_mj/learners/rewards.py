"""Evaluation of learnt rewards: do they rank episodes like the task's score? And PPO on a learnt reward.

Each reward is summed over whole episodes of several kinds in the same scenes of the dev split:

expert     the scripted expert, with score 1
half-way   the expert up to half of its actions, and then random actions
random     random actions
policy     the policies of the trainings themselves

In each environment, two figures compare the sums with the scores. Both are 1 for the score itself. A constant reward
has a correlation of 0 and an AUC of 0.5.

correlation  the rank correlation (Spearman) of sums and scores, with mean ranks for ties
AUC          the probability that a solved episode (score 1) has a larger sum than another one; ties count half
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from os import PathLike
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd
import torch
from msgspec.structs import replace
from numpy.typing import NDArray
from torch import Tensor

from magical_mj.actions import ACTIONS, NOOP
from magical_mj.demos import stored
from magical_mj.demos.demonstration import Demonstration, Demonstrator
from magical_mj.demos.learning import observations
from magical_mj.demos.recording import replayed
from magical_mj.evaluation.run import evaluate
from magical_mj.learners.config import from_toml
from magical_mj.learners.data import Rollout
from magical_mj.learners.learner import Method, threads_for
from magical_mj.learners.networks import as_input
from magical_mj.learners.ppo import RewardLearner
from magical_mj.learners.run_folder import CONFIG, RunFolder
from magical_mj.learners.settings import METHODS, TrainingSettings
from magical_mj.policies.facts import Learnt
from magical_mj.policies.interface import actions_of, histories
from magical_mj.policies.models import torch_settings
from magical_mj.tasks.registry import SPLITS, environments, task_spec
from magical_mj.utils import files
from magical_mj.utils.errors import SettingsError, TrainingError, as_integer, short_repr

SCENES: Final = 5
"""The default number of scenes in each environment."""
KINDS: Final = ("expert", "half-way", "random", "policy")
Watch = Callable[[str], object]
"""Called with the environment that is evaluated next."""


def learns_reward(method: str) -> bool:
    """Whether a method learns a reward."""
    return method in METHODS and METHODS[method].learns_reward


def settings_in(path: Path, trusted: Sequence[str] = ()) -> TrainingSettings:
    """The settings of the training in a folder.

    Raises:
        SettingsError: if the folder contains no training, or its settings are invalid.
    """
    if not (path / CONFIG).is_file():
        raise SettingsError(f"{path} is not the folder of a training: it has no {CONFIG}")
    return from_toml(path / CONFIG, trusted=trusted)


def learner_of_reward(path: Path, settings: TrainingSettings) -> Method:
    """The learner at the end of the training in a folder, for its `learnt_reward`.

    Raises:
        TrainingError: if the training is not finished, or its checkpoint cannot be used.
    """
    folder = RunFolder(path, settings, resume=True)
    last = folder.last_checkpoint()
    if last is None or last.update < last.updates:
        raise TrainingError(f"the training in {path} is not finished: --resume continues it")
    learner = METHODS[settings.method](settings)
    try:
        learner.set_state(last.learner)
    except Exception as error:
        raise folder.unusable_checkpoint(error) from error
    return learner


def agreement(
    sums: Sequence[float] | NDArray[np.float64], scores: Sequence[float] | NDArray[np.float64]
) -> tuple[float, float]:
    """The agreement of the sums of a reward over episodes with their scores: rank correlation and AUC.

    The correlation is in [-1, 1]; 0 if all sums are equal, NaN if all scores are equal. The AUC of solved episodes is
    in [0, 1]; NaN if all episodes or none are solved.
    """
    ranks, wanted = (pd.Series(values).rank().to_numpy() for values in (sums, scores))
    solved = np.asarray(scores) == 1.0
    correlation = auc = np.nan
    if np.ptp(wanted):
        correlation = float(np.corrcoef(ranks, wanted)[0, 1]) if np.ptp(ranks) else 0.0
    if 0 < (count := int(solved.sum())) < len(solved):
        auc = float((ranks[solved].sum() - count * (count + 1) / 2) / (count * (len(solved) - count)))
    return correlation, auc


def evaluate_rewards(
    runs: Path | str | Iterable[Path | str],
    variants: str | Iterable[str] = "all",
    scenes: int = SCENES,
    *,
    jobs: int | None = None,
    watch: Watch = lambda _: None,
) -> pd.DataFrame:
    """The sums of the learnt rewards of some trainings over the same episodes. Experts' episodes are cached.

    Args:
        runs: the folder of a finished training, or several with the same preset. The policies of all of them play.
            Trainings of methods without a learnt reward, such as BC, only contribute their policies.
        variants: the variants, separated by commas.
        scenes: the number of scenes in each environment, from the dev split.
        jobs: the number of processes for the experts and the policies; None: one per core.
        watch: called with each environment.

    Returns:
        A frame with a row for each reward and episode, and the columns run, method, task, variant, seed, kind, player
        (the method of the policy, if it played), score and sum.

    Raises:
        SettingsError: if no training has a learnt reward, their presets differ, or a training is given twice.
        TrainingError: if a training is not finished, or its checkpoint cannot be used.
        DemonstrationError: if the expert cannot solve a scene.
    """
    if as_integer(scenes, 1) is None:
        raise SettingsError(f"scenes must be an integer of at least 1, not {short_repr(scenes)}")
    paths = [files.to_path(run) for run in ([runs] if isinstance(runs, str | PathLike) else runs)]
    settings_of = {path: settings_in(path) for path in paths}
    folders = [path.resolve() for path in paths]
    if twice := [path for path, folder in zip(paths, folders, strict=True) if folders.count(folder) > 1]:
        raise SettingsError(f"give each training once: {twice[-1]} is given twice, and its episodes would count double")
    rewarding = [path for path in paths if learns_reward(settings_of[path].method)]
    if not rewarding:
        able = ", ".join(filter(learns_reward, METHODS))
        raise SettingsError(f"none of these trainings has learnt a reward: give a training of {able}")
    if len(presets := {settings.preset for settings in settings_of.values()}) > 1:
        raise SettingsError(f"the trainings have different presets: {', '.join(sorted(presets))}")
    for path in rewarding:  # before their policies play
        learner_of_reward(path, settings_of[path])
    rows = []
    for task in dict.fromkeys(task for settings in settings_of.values() for task in settings.tasks):
        own = {path: settings for path, settings in settings_of.items() if task in settings.tasks}
        judging = [path for path in rewarding if path in own]
        for _, variant in environments(task, variants) if judging else ():
            watch(f"{task}-{variant}")
            played = list(_episodes(task, variant, scenes, own, jobs))
            rows += [row for path in judging for row in _judged(path, own[path], played)]
    return pd.DataFrame(rows)


def agreements(frame: pd.DataFrame) -> pd.DataFrame:
    """The agreement of each method in each environment, from the result of `evaluate_rewards`.

    Returns:
        A frame with the columns method, task, variant, correlation and auc. Several trainings of a method in an
        environment are averaged.
    """
    rows = []
    for (method, task, variant, _), group in frame.groupby(["method", "task", "variant", "run"], sort=False):
        rows.append((method, task, variant, *agreement(group["sum"].to_numpy(), group["score"].to_numpy())))
    names, measures = ["method", "task", "variant"], ["correlation", "auc"]
    runs = pd.DataFrame(rows, columns=[*names, *measures])
    return runs.groupby(names, sort=False)[measures].mean().reset_index()


class _Played(NamedTuple):
    kind: str
    player: str
    demonstration: Demonstration


def _episodes(
    task: str, variant: str, scenes: int, runs: Mapping[Path, TrainingSettings], jobs: int | None
) -> Iterator[_Played]:
    """The episodes of all kinds in an environment."""
    steps = task_spec(task).horizon()
    keys = [(task, variant, SPLITS["dev"] + number) for number in range(scenes)]
    for made in stored.complete(keys, stored.default_path(), jobs=jobs):
        rng = np.random.default_rng([zlib.crc32(f"{task} {variant}".encode()), made.number])
        expert = np.full(steps, NOOP, np.uint8)
        actions = actions_of(made.actions)
        expert[: len(actions)] = actions
        random = rng.integers(len(ACTIONS), size=steps).astype(np.uint8)
        half = (max(np.flatnonzero(expert != NOOP), default=-1) + 1) // 2  # an expert may have nothing to do
        mixed = np.concatenate([expert[:half], random[half:]])
        kinds: list[tuple[str, NDArray[np.uint8], Demonstrator]] = [
            ("expert", expert, "expert"),
            ("half-way", mixed, "disturbed"),
            ("random", random, "random"),
        ]
        for kind, chosen, demonstrator in kinds:
            yield _Played(kind, "", replayed(task, variant, made.seed, chosen.tolist(), demonstrator))
    policies = {f"{settings.method} {number}": path for number, (path, settings) in enumerate(runs.items())}
    preset = next(iter(runs.values())).preset
    frame = evaluate(policies, tasks=task, variants=variant, episodes=scenes, split="dev", preset=preset, jobs=jobs)
    for row in frame.itertuples():
        demonstration = replayed(task, variant, int(row.seed), actions_of(row.actions), "policy")
        yield _Played("policy", str(row.policy).partition(" ")[0], demonstration)


def _judged(path: Path, settings: TrainingSettings, played: Sequence[_Played]) -> Iterator[dict[str, object]]:
    """A row for each episode."""
    with torch_settings(threads_for(settings)), closing(learner_of_reward(path, settings)) as learner:
        for kind, player, demonstration in played:
            yield {
                "run": str(path),
                "method": settings.method,
                "task": demonstration.task,
                "variant": demonstration.variant,
                "seed": demonstration.scene_seed,
                "kind": kind,
                "player": player,
                "score": demonstration.score,
                "sum": float(rewards(learner, demonstration).double().sum()),
            }


def rewards(learner: Method, demonstration: Demonstration) -> Tensor:
    """A learner's rewards in all steps of an episode, shape (steps,)."""
    settings = learner.settings
    rows: Any = observations(demonstration, settings.preset, settings.renderer)
    inputs = as_input(histories(rows) if settings.states else rows, learner.device)
    actions = torch.as_tensor(demonstration.actions.astype(np.int64), device=learner.device)
    tasks = torch.full_like(actions, settings.tasks.index(demonstration.task))
    with torch.no_grad():
        return learner.learnt_reward(inputs[:-1], inputs[1:], actions, tasks)


class OnLearntReward(RewardLearner):
    """PPO on a learnt reward in the scenes of a variant. It shows whether the reward generalises to this variant.

    It trains a new policy, and does not change the reward. Both learn from states. Unlike all methods of the paper, the
    policy plays in scenes like those of the test. A leaderboard entry must declare the privilege "other scenes".
    """

    parts = ("network", "ppo", "reward")
    observes = "states"
    learns_reward = False
    pairs = True

    def __init__(self, settings: TrainingSettings) -> None:
        super().__init__(settings)
        self._rewarded = learner_of_reward(Path(settings.reward.run), _reward_settings(settings))
        self._rewarded.close()  # its environments are not used

    @classmethod
    def check_settings(cls, settings: TrainingSettings) -> None:
        """Checks that the reward fits the tasks, and that they have the variant."""
        super().check_settings(settings)
        environments(settings.tasks, settings.reward.variant)
        learnt = _reward_settings(settings)
        if not learns_reward(learnt.method):
            raise SettingsError(
                f"{settings.reward.run} is a training of {learnt.method}, which does not learn a reward"
            )
        if learnt.preset != settings.preset or not set(settings.tasks) <= set(learnt.tasks):
            raise SettingsError(
                f"the reward in {settings.reward.run} is for {', '.join(learnt.tasks)} with the preset "
                f"{learnt.preset}, not for {', '.join(settings.tasks)} with {settings.preset}"
            )
        if learnt.demos != settings.demos:
            number = learnt.demos.set
            raise SettingsError(
                f"the reward in {settings.reward.run} was learnt from demonstrations of set {number}: add --set "
                f"demos.set={number}, so that evaluations of the policy record it"
            )

    @property
    def learnt(self) -> Learnt:
        """With the tasks of the reward that are not in the settings."""
        others = [task for task in self._rewarded.settings.tasks if task not in self.settings.tasks]
        return replace(super().learnt, other_tasks=others)

    def learn_reward(self, rollout: Rollout) -> Mapping[str, float]:
        """Does nothing."""
        del rollout
        return {}

    def reward(self, observations: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        """The learnt reward, shape (n,)."""
        known = self._rewarded.settings.tasks
        numbers = torch.tensor([known.index(task) for task in self.settings.tasks], device=tasks.device)[tasks]
        return self._rewarded.learnt_reward(observations[:, :-1], observations[:, 1:], actions, numbers)


def _reward_settings(settings: TrainingSettings) -> TrainingSettings:
    """The settings of the training that learnt the reward."""
    if not settings.reward.run:
        raise SettingsError(
            "ppo needs a learnt reward: --set reward.run=RUN, the folder of a training of gail, airl or another method "
            "that learns a reward"
        )
    return settings_in(Path(settings.reward.run), settings.tasks)
