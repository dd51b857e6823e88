"""The data of a report: scores from one or several folders, their statistics, and comparisons of two policies.

Scores are read line by line into columns, so that a million episodes fit into memory. Actions are not kept.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from importlib.resources import files
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from zlib import crc32

import numpy as np

from magical_mj.evaluation.folder import check_trainings, other_format, recorded_settings
from magical_mj.evaluation.replay import obstacle, replay
from magical_mj.evaluation.reports.provenance import Provenance, provenance
from magical_mj.evaluation.reports.statistics import Summary, by_environment, by_variant, difference
from magical_mj.evaluation.scores import SCORE_TOLERANCE, EpisodeResult, episodes_in
from magical_mj.tasks.registry import ENVIRONMENTS, EVERY_VARIANT, TASKS, Pair, in_order
from magical_mj.tasks.spec import Rules
from magical_mj.utils.errors import EvaluationError, SettingsError
from magical_mj.utils.extras import check_extra

if TYPE_CHECKING:
    import pandas as pd

KEY: Final = ["policy", "run", "task", "variant", "shift", "seed"]
"""The columns that identify an episode."""
SCENE: Final = ["variant", "shift", "task", "seed"]
"""The columns that identify a scene."""
KINDS: Final = ("rules", "preset", "scene", "worlds", "split", "failure")
NAMES: Final = ("policy", "task", "variant", "shift", "body", *KINDS, "version", "mujoco", "gl", "given", "other")
"""The text columns, stored as categories. One more, `folder`, holds the folder of each episode."""
SAME: Final = [*KEY, *KINDS, "score", "actions"]
"""The columns that must be the same in two records of one episode."""

ALIKE: Final = {
    "rules": "such scores cannot be compared; report --rules scores all episodes again by the same rules",
    "worlds": "scores of batched environments are approximate: report them separately",
    "split": "results are scores on test: report those on dev separately",
}
"""The columns that must be the same for all scores, and why."""
PUBLISHED_RULES: Final = "released"
"""The paper's results were scored by the authors' code, in its simulator. Evidence: AL scores 0.00 on ClusterShape's
demo, but by the paper's formula an agent that does nothing scores 0.25."""
PUBLISHED_RUNS: Final = 5
PUBLISHED_EPISODES: Final = 100
"""The number of episodes of each run in each environment."""
ALL: Final = "all of them"
"""The name of a comparison's row over all variants."""


@dataclass(frozen=True)
class Results:
    """The data of a report.

    Attributes:
        scores: a row for each episode; see `gather`.
        environments: a row for each policy and environment that was played without shifts. `published` is true for the
            paper's results; `rules` are the rules of the scores.
        variants: a row for each policy and variant, over tasks; `missing` names the tasks without episodes.
        lacks_published: whether the paper's results were requested, but the paper has none in these tasks.
        provenance: the planned episodes, and the differences from the official protocol.
    """

    scores: pd.DataFrame
    environments: pd.DataFrame
    variants: pd.DataFrame
    lacks_published: bool
    provenance: Provenance

    @property
    def mark(self) -> str:
        """A note for tables and figures: how the results differ from the official protocol. Empty if they do not."""
        differs = "; ".join(self.provenance.deviations)
        return f"Not by the official protocol: {differs}" if differs else ""

    @property
    def policies(self) -> list[str]:
        """The methods in the order of tables, the published ones last."""
        return list(dict.fromkeys(self.environments["policy"]))

    @property
    def given(self) -> dict[str, list[str]]:
        """The methods by the description of tasks that they received. The first group, "", received none."""
        what: dict[str, str] = dict(self.scores.drop_duplicates("policy")[["policy", "given"]].to_numpy().tolist())
        groups: dict[str, list[str]] = {}
        for policy in self.policies:
            groups.setdefault(what.get(policy, ""), []).append(policy)
        return dict(sorted(groups.items()))

    @property
    def shown_variants(self) -> tuple[str, ...]:
        """The variants in tables and figures: those with results."""
        played = set(self.environments["variant"])
        return tuple(name for name in EVERY_VARIANT if name in played)

    @property
    def tasks(self) -> list[str]:
        """All tasks with results, in the order of tables."""
        return in_order(self.environments["task"])


def gather(
    folders: Sequence[Path],
    mixed_presets: bool = False,
    rules: Rules | None = None,
    trusted: Collection[str] = (),
    **replaying: Any,
) -> pd.DataFrame:
    """The scores of all folders, a row for each episode, in a fixed order. Arguments are those of `report`.

    `replaying` are the arguments `jobs` and `watch` of `episodes_of`.

    Returns:
        A frame with the columns `NAMES`, `folder`, `run`, `seed`, `score`, `other_score`, and `actions` (a checksum).
        An episode that is in several folders has one row. The name of a method includes its wrapper, and what it was
        given.

    Raises:
        EvaluationError: if `folders` is empty, one is not an evaluation, two hold the same episode with different
            results, two runs of a method have the same policy, or rules, worlds, splits, presets or scenes differ.
    """
    if not folders:
        raise EvaluationError("give at least one folder of an evaluation")
    check_trainings(folders)
    scores = _read(folders, rules, trusted, **replaying)
    check_alike(scores)
    scores = scores.drop_duplicates(SAME)  # a folder and its copy hold the same episodes
    twice = scores[scores.duplicated(KEY, keep=False)]
    if len(twice):
        first, second = twice.iloc[0], twice.iloc[1]
        raise EvaluationError(
            f"{first.folder} and {second.folder} both hold run {first.run} of {first.policy} in {first.task} "
            f"{first.variant}, seed {first.seed}, with different results; evaluate one of them with another --run or "
            "NAME=POLICY"
        )
    if not mixed_presets:
        check_same(scores, "preset", "--mixed-presets (mixed_presets=True) reports them together anyway")
    return scores.reset_index(drop=True)


def episodes_of(
    folder: Path,
    rules: Rules | None,
    trusted: Collection[str] = (),
    *,
    jobs: int | None = None,
    watch: Callable[[int, int], object] = lambda _done, _total: None,
) -> Iterator[EpisodeResult]:
    """The episodes of an evaluation or an entry, scored by these rules. Those scored by others are replayed.

    `watch` is called with the number of replayed episodes, and their total number. For `trusted` and `jobs`, see
    `replay`.
    """
    other = other_format(folder)
    episodes = episodes_in(folder) if other is None else other.episodes(folder)
    if rules is None:
        yield from episodes
        return
    recorded = recorded_settings(folder)
    others: list[tuple[str, EpisodeResult]] = []
    for episode in episodes:
        if episode.rules == rules:
            yield episode
        elif problem := obstacle(episode, recorded, trusted):
            raise EvaluationError(f"{folder} cannot be scored by the rules {rules!r}: {episode.title}: {problem}")
        else:
            others.append(("", episode))
    for done, (_, episode, problem) in enumerate(replay(others, rules=rules, jobs=jobs, trusted=trusted), start=1):
        watch(done, len(others))
        if problem is not None:
            raise EvaluationError(f"{folder} cannot be scored by the rules {rules!r}: {problem}")
        yield episode


def _read(
    folders: Sequence[Path],
    rules: Rules | None = None,
    trusted: Collection[str] = (),
    **replaying: Any,
) -> pd.DataFrame:
    import pandas as pd

    categories: dict[str, dict[str | None, int]] = {name: {None: -1} for name in NAMES}
    codes = {name: array("i") for name in (*NAMES, "folder")}
    numbers = {"run": array("q"), "seed": array("q"), "score": array("d"), "actions": array("q")}
    numbers["other_score"] = array("d")
    texts_of = attrgetter(*("method" if name == "policy" else name for name in NAMES))
    columns_of_texts = [(known, codes[name].append) for name, known in categories.items()]
    for index, folder in enumerate(folders):
        for score in episodes_of(folder, rules, trusted, **replaying):
            for text, (known, append) in zip(texts_of(score), columns_of_texts, strict=True):
                append(known.setdefault(text, len(known) - 1))
            numbers["actions"].append(crc32(score.actions.encode()))
            for name in ("run", "seed", "score"):
                numbers[name].append(getattr(score, name))
            numbers["other_score"].append(np.nan if score.other_score is None else score.other_score)
            codes["folder"].append(index)
    columns: dict[str, Any] = {name: np.asarray(column) for name, column in numbers.items()}
    for name, known in categories.items():
        texts = pd.Index([text for text in known if text is not None], dtype=object)
        columns[name] = pd.Categorical.from_codes(codes[name], texts).reorder_categories(sorted(texts))
    columns["folder"] = pd.Categorical.from_codes(codes["folder"], list(map(str, folders)))
    scores = pd.DataFrame(columns)
    return scores.sort_values(KEY, kind="stable", ignore_index=True)


def check_same(scores: pd.DataFrame, what: str, consequence: str) -> None:
    """Raises an `EvaluationError`, which ends with `consequence`, if a column has different values apart from None."""
    kinds = scores.dropna(subset=[what]).drop_duplicates(what)
    if len(kinds) > 1:
        listed = ", ".join(f"{row[what]} in {row['folder']}" for row in kinds.sort_values("folder").to_dict("records"))
        raise EvaluationError(f"different {what}: {listed}; {consequence}")


def check_alike(scores: pd.DataFrame) -> None:
    """Raises an `EvaluationError` if a column of `ALIKE` differs, or if the scenes of a seed have different digests."""
    for what, consequence in ALIKE.items():
        check_same(scores, what, consequence)
    scene = ["task", "variant", "shift", "body", "seed"]
    digests = scores.dropna(subset=["scene"]).drop_duplicates([*scene, "scene"])
    differing = digests[digests.duplicated(scene, keep=False)].sort_values([*scene, "folder"], kind="stable")
    if len(differing):
        first, second = differing.iloc[:2].itertuples()
        raise EvaluationError(
            f"different scenes in {first.task} {first.variant}, seed {first.seed}: {first.scene} in {first.folder}, "
            f"{second.scene} in {second.folder}; they follow different protocols, so their scores cannot be compared: "
            "evaluate both with one version"
        )


def results(
    folders: Sequence[Path],
    with_published: bool = False,
    mixed_presets: bool = False,
    rules: Rules | None = None,
    trusted: Collection[str] = (),
    **replaying: Any,
) -> Results:
    """The data of a report on these folders. Arguments and errors are those of `gather`.

    With `with_published`, a method that has the name of a published one is an `EvaluationError`.
    """
    import pandas as pd

    scores = gather(folders, mixed_presets, rules, trusted, **replaying)
    plain = scores[scores["shift"] == ""]
    if plain.empty:
        raise EvaluationError("all episodes are shifted: evaluate --resume plays those without shifts")
    tasks = in_order(plain["task"])
    shows_published = with_published and bool(set(tasks) & set(TASKS))
    own = list(scores["policy"].cat.categories)
    papers = list(dict.fromkeys(published_results()["policy"])) if shows_published else []
    if taken := [name for name in own if name in papers]:
        raise EvaluationError(
            f"the paper has methods named {', '.join(map(repr, taken))} as well: evaluate yours under another name "
            "(--policy NAME=...), or leave out the published results"
        )
    marks = {"published": False, "rules": str(scores["rules"].iloc[0]), "split": str(scores["split"].iloc[0])}
    environments = by_environment(plain).assign(**marks)
    variants = by_variant(plain[plain["task"].isin(counted_tasks(tasks))]).assign(**marks)
    if shows_published:
        marks = {"published": True, "rules": PUBLISHED_RULES, "split": "test"}
        alone = counted_tasks(tasks) if len(tasks) == 1 else TASKS
        environments = pd.concat([environments, published_by_environment(alone).assign(**marks)])
        variants = pd.concat([variants, published_by_variant(alone).assign(**marks)])
    environments, variants = (_sorted(table, [*own, *papers]) for table in (environments, variants))
    variants["missing"] = _missing(environments, variants)
    lacks_published = with_published and not shows_published
    return Results(scores, environments, variants, lacks_published, provenance(folders, scores))


def counted_tasks(tasks: Sequence[str] | pd.Series[str]) -> list[str]:
    """The tasks that means include: the benchmark's. If only one task or none of the benchmark's was played: these."""
    played = in_order(tasks)
    return list(TASKS) if len(played) > 1 and set(played) & set(TASKS) else played


def expected_environments(environments: pd.DataFrame) -> list[Pair]:
    """The benchmark's environments of the `counted_tasks`. If none of these is the benchmark's: those played."""
    own = environments[~environments["published"]]
    counted = counted_tasks(own["task"])
    benchmark = [pair for pair in ENVIRONMENTS if pair[0] in counted]
    return benchmark or list(dict.fromkeys(zip(own["task"], own["variant"], strict=True)))


def _sorted(table: pd.DataFrame, policies: list[str]) -> pd.DataFrame:
    """In the order of policies, tasks and variants."""
    ranks = {"policy": policies, "task": in_order(table["task"]) if "task" in table else ()}
    ranks["variant"] = EVERY_VARIANT
    keys = [name for name in ranks if name in table]
    return table.sort_values(keys, key=lambda column: column.map(list(ranks[column.name]).index), ignore_index=True)


def _missing(environments: pd.DataFrame, variants: pd.DataFrame) -> list[str]:
    """For each row of `variants`, the names of the tasks without episodes, separated by commas."""
    own = environments.loc[~environments["published"], ["policy", "task", "variant"]]
    played = set(own.itertuples(index=False, name=None))
    pairs = expected_environments(environments)

    def lacked(policy: str, variant: str) -> str:
        return ", ".join(task for task, other in pairs if other == variant and (policy, task, variant) not in played)

    return ["" if row.published else lacked(row.policy, row.variant) for row in variants.itertuples()]


def published_results() -> pd.DataFrame:
    """The results in the paper (Toyer et al. 2020, appendix): 11 methods in all environments.

    Returns:
        A frame with policy, task, variant, and the mean and standard deviation over the mean scores of five runs.
    """
    return _from_paper("paper_results.csv")


def published_table_1() -> pd.DataFrame:
    """The paper's Table 1: the means and standard deviations over tasks of ten methods in five variants.

    Means over `published_results`, which have two decimals, differ from them by up to 0.01.
    """
    return _from_paper("paper_table_1.csv")


def _from_paper(name: str) -> pd.DataFrame:
    import pandas as pd

    with (files("magical_mj.evaluation") / name).open(encoding="utf-8") as file:
        return pd.read_csv(file).rename(columns={"method": "policy"})


def published_by_environment(tasks: Sequence[str] = TASKS) -> pd.DataFrame:
    """The published results in some tasks, with the columns of `statistics.by_environment`."""
    counts = {"runs": PUBLISHED_RUNS, "episodes": PUBLISHED_RUNS * PUBLISHED_EPISODES, "failures": 0}
    published = published_results()
    return _completed(published[published["task"].isin(tasks)].assign(**counts))


def published_by_variant(tasks: Sequence[str] = TASKS) -> pd.DataFrame:
    """The published results over some tasks, with the columns of `statistics.by_variant`; over all, as printed."""
    import pandas as pd

    rows = []
    for (policy, variant), group in published_by_environment(tasks).groupby(["policy", "variant"], sort=False):
        means, stds = group["mean"].to_numpy(float), group["std"].to_numpy(float)
        spread = float(np.sqrt((stds**2).mean() + means.var()))  # variance within tasks plus variance between them
        episodes = PUBLISHED_RUNS * PUBLISHED_EPISODES * len(group)
        counts = {"tasks": len(group), "runs": PUBLISHED_RUNS, "episodes": episodes}
        rows.append({"policy": policy, "variant": variant, "mean": round(means.mean(), 9), "std": spread, **counts})
    table = pd.DataFrame(rows).set_index(["policy", "variant"])
    if tuple(tasks) == TASKS:
        table.update(published_table_1().set_index(["policy", "variant"]))
    return _completed(table.reset_index())


def _completed(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(**{name: np.nan for name in Summary._fields if name not in table})


def choose(which: Path | str) -> tuple[str, pd.DataFrame]:
    """The name and the scores of a policy given as ``DIR``, or as ``DIR:POLICY`` if the folder holds several."""
    parts = str(which).split(":")  # names of folders and of policies may hold colons
    splits = [(":".join(parts[:count]), ":".join(parts[count:])) for count in range(len(parts), 0, -1)]
    folder, policy = next((split for split in splits if split[0] and Path(split[0]).is_dir()), splits[0])
    scores = _read([Path(folder)])
    names = list(scores["policy"].cat.categories)
    is_clear = policy in names if policy else len(names) <= 1
    if not is_clear:
        raise SettingsError(f"{folder} holds {', '.join(names)}: name one of them, as in {folder}:{names[0]}")
    policy = policy or names[0]
    return policy, scores[scores["policy"] == policy].assign(folder=policy)


def compare(first: Path | str, second: Path | str) -> pd.DataFrame:
    """How much better the first policy is than the second, in each variant and shift, on the scenes that both played.

    Args:
        first: the folder of an evaluation, or ``DIR:POLICY`` if it holds several policies.
        second: the other policy, in the same form.

    Returns:
        A row for each variant and shift, and one over all variants without shifts. Columns: the mean scores (`first`,
        `second`), their `difference` and its 95 % interval (`low`, `high`; see
        `magical_mj.evaluation.reports.intervals`), in how many scenes the mean over runs of the first was `better` or
        `worse`, the smaller number of `runs`, the numbers of common `scenes` and `environments`, and the number of
        scenes that only one of them has played (`unpaired`). Its `attrs` hold the names of the `policies` and the
        `split`.

    Raises:
        SettingsError: if the choice of policies is ambiguous.
        EvaluationError: if they were scored by different rules or in different kinds of worlds, if the scenes of a
            seed differ, or if they have no scene in common.
    """
    check_extra("comparisons", "eval")
    import pandas as pd

    (name, ours), (other, others) = choose(first), choose(second)
    sides = [side.astype(dict.fromkeys(NAMES, object)) for side in (ours, others)]
    played = pd.concat(sides, ignore_index=True)
    check_alike(played)
    scenes = [side[SCENE].drop_duplicates() for side in sides]
    both = scenes[0].merge(scenes[1])
    if both.empty:
        raise EvaluationError(f"{first} and {second} have no scene in common")
    every = pd.concat(scenes).drop_duplicates()
    paired = [side.merge(both) for side in sides]

    def rank(pair: tuple[str, str]) -> tuple[bool, int, str]:
        variant, shift = pair
        return shift != "", EVERY_VARIANT.index(variant), shift

    def row(title: str, chosen: Callable[[pd.DataFrame], pd.Series[bool]]) -> dict[str, Any]:
        compared = [side[chosen(side)] for side in paired]
        means = [side.groupby(SCENE)["score"].mean() for side in compared]
        better = means[0] - means[1]
        return {
            "variant": title,
            **difference(*compared, same_runs=False),
            "better": int((better > SCORE_TOLERANCE).sum()),
            "worse": int((better < -SCORE_TOLERANCE).sum()),
            "unpaired": int(chosen(every).sum() - chosen(both).sum()),
        }

    groups = sorted(set(both[["variant", "shift"]].itertuples(index=False, name=None)), key=rank)
    rows = [
        row(
            " ".join(filter(None, pair)),
            lambda side, pair=pair: (side["variant"] == pair[0]) & (side["shift"] == pair[1]),
        )
        for pair in groups
    ]
    if (both["shift"] == "").any():
        rows.append(row(ALL, lambda side: side["shift"] == ""))
    table = pd.DataFrame(rows)
    table.attrs |= {"policies": (name, other), "split": str(played["split"].iloc[0])}
    return table
