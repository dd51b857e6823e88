"""The data of a report: scores from one or several folders, their statistics, and notes about them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from magical_mj.evaluation.reports.published import (
    PUBLISHED_EPISODES,
    PUBLISHED_RULES,
    PUBLISHED_RUNS,
    published_by_environment,
    published_by_variant,
    published_results,
)
from magical_mj.evaluation.reports.statistics import by_environment, by_variant
from magical_mj.evaluation.scores import Key, Score, frame, read
from magical_mj.evaluation.settings import UNOFFICIAL
from magical_mj.tasks.registry import ENVIRONMENTS, TASKS, VARIANTS, in_order
from magical_mj.utils.errors import EvaluationError, shown

if TYPE_CHECKING:
    import pandas as pd

APPROXIMATE: Final = "Approximate, no official results"


@dataclass(frozen=True)
class Results:
    """The data of a report.

    Attributes:
        scores: a row for each episode.
        environments: a row for each policy and environment; `published` says whether it is a published result, `rules`
            how it was scored.
        variants: a row for each policy and variant, over tasks; `missing` names the tasks that it lacks.
        notes: sentences that readers must know.
    """

    scores: pd.DataFrame
    environments: pd.DataFrame
    variants: pd.DataFrame
    notes: tuple[str, ...]

    @property
    def policies(self) -> list[str]:
        """The methods in their order, the published ones last."""
        return list(dict.fromkeys(self.environments["policy"]))

    @property
    def counted(self) -> str:
        """What means over tasks are taken over, as titles say it."""
        tasks = counted_tasks(self.scores)
        return "all tasks" if set(tasks) & set(TASKS) else " and ".join(tasks)


def gather(folders: Sequence[Path], mixed_presets: bool = False) -> list[Score]:
    """The scores of all folders.

    Raises:
        EvaluationError: if there are no folders, one is not an evaluation or names an unknown variant, two hold the
            same episode, or rules, presets or scenes differ.
    """
    if not folders:
        raise EvaluationError("give at least one folder of an evaluation")
    found: dict[Key, tuple[Score, Path]] = {}
    for folder in folders:
        for score in read(folder):
            if score.variant not in VARIANTS:
                raise EvaluationError(
                    f"{folder} holds results in the variant {shown(score.variant)}; there are: {', '.join(VARIANTS)}"
                )
            if score.key in found:
                raise EvaluationError(
                    f"{found[score.key][1]} and {folder} both hold run {score.run} of {score.policy} in {score.task} "
                    f"{score.variant}, seed {score.seed}; evaluate one of them with another --run or NAME=POLICY"
                )
            found[score.key] = score, folder
    scores = [score for score, _ in found.values()]
    check_same(found.values(), "rules", "their scores cannot be compared")
    check_same(found.values(), "worlds", "scores of batched worlds are approximate, and reported by themselves")
    if not mixed_presets:
        check_same(found.values(), "preset", "--mixed-presets (mixed_presets=True) reports them together anyway")
    check_scenes(found.values())
    return scores


def check_same(found: Iterable[tuple[Score, object]], what: str, consequence: str) -> None:
    """Raises an `EvaluationError` unless this attribute is the same in all scores; None matches anything.

    Args:
        found: scores and their sources.
        what: the attribute's name.
        consequence: the end of the message: what a difference means.
    """
    where: dict[str, object] = {}
    for score, folder in found:
        if getattr(score, what) is not None:
            where.setdefault(getattr(score, what), folder)
    if len(where) > 1:
        kinds = ", ".join(f"{name or 'none'} in {folder}" for name, folder in where.items())
        raise EvaluationError(f"different {what}: {kinds}; {consequence}")


def check_scenes(found: Iterable[tuple[Score, object]]) -> None:
    """Raises an `EvaluationError` if a seed's scene has two digests: of other worlds, scores do not compare.

    Args:
        found: scores and their sources. Scenes whose digest was not recorded match any.
    """
    known: dict[tuple[str, str, int], tuple[str, object]] = {}
    for score, folder in found:
        if score.scene is not None:
            scene, where = known.setdefault((score.task, score.variant, score.seed), (score.scene, folder))
            if scene != score.scene:
                raise EvaluationError(
                    f"different scenes in {score.task} {score.variant}, seed {score.seed}: {scene} in {where}, "
                    f"{score.scene} in {folder}; they follow different protocols, and their scores do not compare: "
                    "evaluate both with one version"
                )


def results(folders: Sequence[Path], with_published: bool = False, mixed_presets: bool = False) -> Results:
    """The data of a report on these folders.

    Raises:
        EvaluationError: as `gather`, or if a method has the name of a published one, and these are shown as well.
    """
    import pandas as pd

    scores = frame(gather(folders, mixed_presets))
    asked, with_published = with_published, with_published and bool(set(scores["task"]) & set(TASKS))
    theirs = list(dict.fromkeys(published_results()["policy"])) if with_published else []
    taken = [name for name in dict.fromkeys(scores["policy"]) if name in theirs]
    if taken:
        raise EvaluationError(
            f"the paper has methods named {', '.join(map(repr, taken))} as well: evaluate yours under another name "
            "(--policy NAME=...), or leave out the published results"
        )
    rules = str(scores["rules"].iloc[0])
    environments = by_environment(scores).assign(published=False, rules=rules)
    counted = scores[scores["task"].isin(counted_tasks(scores))]
    variants = by_variant(counted).assign(published=False, rules=rules)
    if with_published:
        marks = {"published": True, "rules": PUBLISHED_RULES}
        environments = pd.concat([environments, published_by_environment().assign(**marks)])
        variants = pd.concat([variants, published_by_variant().assign(**marks)])
    order = [*dict.fromkeys(scores["policy"]), *theirs]
    environments = _sorted(environments, order)
    variants = _sorted(variants, order)
    variants["missing"] = [_missing(counted, row) for row in variants.itertuples()]
    notes = [*_notes(scores, variants, with_published)]
    if asked and not with_published:
        notes.append("The paper's results are not shown: it has none in these tasks.")
    return Results(scores, environments, variants, tuple(notes))


def counted_tasks(scores: pd.DataFrame) -> list[str]:
    """The tasks over which means are taken: the benchmark's, or if there are none, users' own."""
    played = in_order(scores["task"])
    return list(TASKS) if set(played) & set(TASKS) else played


def _sorted(table: pd.DataFrame, policies: list[str]) -> pd.DataFrame:
    """In the order of policies, tasks and variants."""
    ranks = {"policy": policies, "task": in_order(table["task"]) if "task" in table else (), "variant": VARIANTS}
    keys = [name for name in ranks if name in table]
    return table.sort_values(keys, key=lambda column: column.map(list(ranks[column.name]).index), ignore_index=True)


def _missing(scores: pd.DataFrame, row: Any) -> str:
    if row.published:
        return ""
    there = set(scores[(scores["policy"] == row.policy) & (scores["variant"] == row.variant)]["task"])
    own = scores[["task", "variant"]].drop_duplicates().itertuples(index=False)  # pairs that were played
    needed = ENVIRONMENTS if set(scores["task"]) & set(TASKS) else [(task, variant) for task, variant in own]
    return ", ".join(task for task, variant in needed if variant == row.variant and task not in there)


def _notes(scores: pd.DataFrame, variants: pd.DataFrame, with_published: bool) -> Iterator[str]:
    if "batched" in set(scores["worlds"]):
        yield f"{APPROXIMATE}: {UNOFFICIAL}."
    if (variants["missing"] != "").any():
        yield "(m/n) after a number: the mean is over only m of the n tasks with the variant."
    own = [task for task in in_order(scores["task"]) if task not in counted_tasks(scores)]
    if own:
        yield f"Tasks that are not of the benchmark, and so not part of the means over tasks: {', '.join(own)}."
    for policy, group in variants[~variants["published"]].groupby("policy", sort=False):
        lacking: dict[str, list[str]] = {}
        for row in group.itertuples():
            if row.missing:
                lacking.setdefault(str(row.missing), []).append(str(row.variant))
        for tasks, names in lacking.items():
            yield f"{policy}: incomplete in {', '.join(names)}: without {tasks}."
        absent = [variant for variant in VARIANTS if variant not in set(group["variant"])]
        if absent:
            yield f"{policy}: not evaluated in {', '.join(absent)}."
    most = int(scores["seed"].max()) + 1
    counts = scores.groupby(["policy", "run", "task", "variant"], sort=False)["seed"].nunique()
    short = counts[counts < most]
    if len(short):
        (policy, run, task, variant), count = short.index[0], short.iloc[0]
        others = f", and {len(short) - 1} more are short" if len(short) > 1 else ""
        yield f"Unfinished: {policy}, run {run}, {task} {variant} has {count} of {most} episodes{others}."
    runs = scores.groupby(["policy", "task", "variant"], sort=False)["run"].nunique().groupby("policy", sort=False)
    for policy, numbers in runs:
        if numbers.nunique() > 1:
            lone = "; where there is one only, its episodes are resampled for intervals" if numbers.min() == 1 else ""
            yield f"{policy}: between {numbers.min()} and {numbers.max()} runs, depending on the environment{lone}."
    if (runs.max() == 1).any():
        names = ", ".join(runs.max()[runs.max() == 1].index)
        yield f"One run only of {names}: its intervals are over episodes and say nothing about training."
    failed = scores[scores["failure"].notna()]
    for policy, group in failed.groupby("policy", sort=False):
        yield f"{policy}: failed episodes, which count as 0: {len(group)}; the first reason: {group['failure'].iloc[0]}"
    for what, name in (
        ("version", "versions of magical_mj"),
        ("mujoco", "versions of MuJoCo"),
        ("gl", "OpenGL backends"),
    ):
        if scores[what].nunique() > 1:
            yield f"Played with different {name}: {', '.join(sorted(scores[what].unique()))}."
    if with_published:
        rules = str(scores["rules"].iloc[0])
        others = "" if rules == PUBLISHED_RULES else f", and all others by the rules {rules!r}"
        yield (
            f"† Published results: in the original simulator, {PUBLISHED_RUNS} runs of {PUBLISHED_EPISODES} episodes, "
            f"scored by the rules {PUBLISHED_RULES!r}{others}."
        )
