"""Makes a leaderboard entry from the folders of evaluations."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec

from magical_mj.evaluation.entry import (
    GIVEN,
    SUFFIX,
    Card,
    Entry,
    Versions,
    common,
    has_place,
    packed,
    undeclared,
    unpacked,
)
from magical_mj.evaluation.folder import (
    SETTINGS,
    check_runs,
    folders_of,
    read_settings,
    recorded_policies,
    recorded_sets,
    recorded_variants,
)
from magical_mj.evaluation.replay import obstacle
from magical_mj.evaluation.scores import EpisodeResult, read
from magical_mj.scene.bodies import GRIPPER
from magical_mj.tasks.registry import ENVIRONMENTS
from magical_mj.utils import files
from magical_mj.utils.errors import EvaluationError, SettingsError, check_name

PLAIN: Final = {
    "split": ("test", "on the split {}, but entries must be played on test"),
    "body": (GRIPPER, "with the body {}, but entries must be played with the gripper"),
    "other": ("", "as a control, with what belongs to {}"),
}
"""Field -> the value that all episodes of an entry must have, and the error for other values."""


def submit(
    folders: Iterable[Path | str],
    out: Path | str,
    *,
    card: Path | str | None = None,
    policy: str | None = None,
) -> Entry:
    """Makes an entry from one or several evaluations, and writes it.

    Args:
        folders: evaluations of one method, such as one for each run. Shifted episodes outside the `track` are left out.
        out: the file. Its name must end in .json.xz. An existing file is not replaced.
        card: a TOML file with fields of `Card`, all optional. By default, the method is named as in the evaluations.
        policy: the name of the method in the folders, if they hold several.

    Raises:
        SettingsError: if the card has unknown fields or values of the wrong kind, or the choice of a method is
            ambiguous.
        UnknownNameError: if `policy` is not in the folders.
        EvaluationError: if a folder is not an evaluation, or the folders cannot be combined.
        OSError: if the file exists or cannot be written.
    """
    out, folders = files.to_path(out), folders_of(folders)
    if not out.name.endswith(SUFFIX):
        raise SettingsError(f"{out} must end in {SUFFIX}")
    if not folders:
        raise SettingsError("give at least one folder of an evaluation")
    described = {} if card is None else files.read_toml(files.to_path(card))
    read_all = ((episode, folder) for folder in folders for episode in read(folder))
    sources = [source for source in read_all if has_place(source[0].task, source[0].variant, source[0].shift)]
    names = list(dict.fromkeys(episode.policy for episode, _ in sources))
    if not names:
        raise EvaluationError("all episodes have shifts outside the shift track: an entry cannot hold them")
    if policy is not None:
        check_name("policy", policy, names)
    elif len(names) > 1:
        raise SettingsError(
            f"the folders hold {', '.join(names)}: choose one with --policy NAME; if they are runs of one "
            "method, evaluate them again under its name, as in evaluate --policy BC=runs/a,BC=runs/b"
        )
    name = policy or names[0]
    try:
        new_card = msgspec.convert({"method": name, **described}, Card)
    except msgspec.ValidationError as error:
        raise SettingsError(f"the card is not valid{f' in {card}' if card else ''}: {error}") from None
    check_trainings(folders, name)
    check_declared(folders, new_card, name)
    entry = _combined(new_card, [source for source in sources if source[0].policy == name], folders)
    content = packed(entry)
    unpacked(content, "the choice of folders")
    out.parent.mkdir(parents=True, exist_ok=True)
    files.write(out, content)
    return entry


def _settings(folder: Path) -> dict[str, Any]:
    """The settings in an evaluation's ``run.json``. Empty if it has none; an `EvaluationError` if they are invalid."""
    return read_settings(folder) if (folder / SETTINGS).exists() else {}


def check_trainings(folders: Sequence[Path], method: str | None = None) -> None:
    """Raises an `EvaluationError` if two runs of a method have equal policies: each run must be a separate training.

    Only the policy `method` is checked; with None, all are.
    """
    check_runs(
        (name, run, digest)
        for settings in map(_settings, folders)
        for policy, name, run, digest in recorded_policies(settings)
        if policy == (method or policy)
    )


def check_declared(folders: Sequence[Path], card: Card, method: str) -> None:
    """Raises a `SettingsError` if the card does not declare what the policies learnt from.

    This is the set of demonstrations, and play in scenes of test variants. Evaluations know it of the trainings of this
    package only, and record set 1 and no play for other policies. So a card may declare another set for these.
    """
    known = map(_settings, folders)
    learnt = {number for settings in known for number in recorded_sets(settings).get(method, ())}
    if len(learnt) > 1 or learnt - {1, card.demonstrations.loaded_set}:
        numbers = ", ".join(map(str, sorted(learnt)))
        raise SettingsError(
            f"{method} learnt from demonstrations of set {numbers}, but the card has [demonstrations] loaded_set = "
            f"{card.demonstrations.loaded_set}: declare the set, and submit policies of one set only"
        )
    if problem := undeclared(card, _played_in(folders, method)):
        raise SettingsError(f"{method} {problem}")


def _played_in(folders: Sequence[Path], method: str) -> list[str]:
    """The variants, apart from Demo, of the scenes in the training of a method's policies."""
    known = map(_settings, folders)
    return sorted({name for settings in known for name in recorded_variants(settings).get(method, ())} - {"Demo"})


def _combined(card: Card, sources: Sequence[tuple[EpisodeResult, Path]], folders: Sequence[Path]) -> Entry:
    """The entry of one method's episodes, each given with its folder.

    Raises:
        EvaluationError: if they differ in observations, rules or protocol, or cannot be part of an entry.
    """
    for episode, folder in sources:
        for name, (usual, problem) in PLAIN.items():
            if (value := getattr(episode, name)) != usual:
                raise EvaluationError(f"{folder} was played {problem.format(value)}")
        if episode.demonstrations and GIVEN not in (card.privileges or ()):
            raise EvaluationError(f'{folder} was played with {episode.given}: add "{GIVEN}" to the card\'s privileges')
        if (episode.task, episode.variant) in ENVIRONMENTS and (problem := obstacle(episode)):
            raise EvaluationError(
                f"{folder} cannot be an entry, because it cannot be replayed: {episode.title}: {problem}"
            )
    episodes = [episode for episode, _ in sources]
    return Entry(
        card,
        common("preset", ((episode.preset, folder) for episode, folder in sources)),
        common("rules", ((episode.rules, folder) for episode, folder in sources)),
        common("protocol", ((_settings(folder).get("protocol"), folder) for folder in folders)),
        Versions(*(sorted({getattr(episode, name) for episode in episodes}) for name in Versions.__struct_fields__)),
        episodes,
        _played_in(folders, episodes[0].policy),
    )
