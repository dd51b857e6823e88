"""Makes a leaderboard entry from the folders of evaluations."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Final

import msgspec

from magical_mj.evaluation.folder import check_trainings, folders_of, recorded_policies, recorded_settings
from magical_mj.evaluation.replay import obstacle
from magical_mj.evaluation.scores import EpisodeResult, read
from magical_mj.leaderboard.entry import (
    GIVEN,
    SUFFIX,
    Card,
    Entry,
    Recorded,
    Versions,
    common,
    given_in,
    packed,
    unpacked,
)
from magical_mj.leaderboard.places import in_track, places
from magical_mj.scene.bodies import GRIPPER
from magical_mj.utils import files
from magical_mj.utils.errors import EvaluationError, SettingsError, check_name

PLAIN: Final = {
    "split": ("test", "on the split {}, but entries must be played on test"),
    "body": (GRIPPER, "with the body {}, but entries must be played with the gripper"),
    "other": ("", "as a control, with the demonstrations or the instruction of {}"),
}
"""Field -> the value that all episodes of an entry must have, and the error for other values."""


def submit(
    folders: Iterable[Path | str], out: Path | str, *, card: Path | str | None = None, policy: str | None = None
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
    sources = [(row, folder) for row, folder in read_all if not row.shift or in_track(row.task, row.variant, row.shift)]
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
    known = {folder: recorded_settings(folder) for folder in folders}
    check_trainings(known, name)
    learnt = [row for settings in known.values() for row in recorded_policies(settings) if row.name == name]
    if unfinished := [row for row in learnt if row.unfinished]:
        raise EvaluationError(
            f"the training of {name}, run {unfinished[0].run}, has stopped at {unfinished[0].unfinished}: finish it "
            "with magical-mj train --resume, and evaluate it again"
        )
    _check_set(new_card, name, {row.demonstration_set for row in learnt})
    own = [source for source in sources if source[0].policy == name]
    for episode, folder in own:
        _check_episode(episode, folder, new_card)
    episodes = [episode for episode, _ in own]
    uses = sorted({use for row in learnt for use in row.uses})
    steps = sum(episode.steps for episode in episodes)
    seconds = math.fsum(episode.seconds for episode in episodes)  # exact, so that the order does not matter
    entry = Entry(
        new_card,
        common("preset", ((episode.preset, folder) for episode, folder in own)),
        common("rules", ((episode.rules, folder) for episode, folder in own)),
        common("protocol", ((settings.get("protocol"), folder) for folder, settings in known.items())),
        Versions(*(sorted({getattr(episode, name) for episode in episodes}) for name in Versions.__struct_fields__)),
        episodes,
        played_in=sorted({variant for row in learnt for variant in row.played_in.split(",")} - {"Demo"}),
        other_tasks=sorted({task for row in learnt for task in row.other_tasks}),
        recorded=Recorded(
            uses,
            sorted({row.loaded for row in learnt} - {""}),
            round(1000 * seconds / steps, 2) if uses and steps else None,
            *given_in(own),
        ),
    )
    if problem := entry.undeclared:
        raise SettingsError(f"{name} {problem}")
    content = packed(entry)
    unpacked(content, "the choice of folders")
    out.parent.mkdir(parents=True, exist_ok=True)
    files.write(out, content)
    return entry


def _check_set(card: Card, method: str, sets: set[int]) -> None:
    """Raises a `SettingsError` if the card does not declare the set of demonstrations.

    It is known only for trainings of this package. For other policies, evaluations record set 1, so a card may declare
    another set.
    """
    if len(sets) > 1 or sets - {1, card.demonstrations.loaded_set}:
        raise SettingsError(
            f"{method} learnt from demonstrations of set {', '.join(map(str, sorted(sets)))}, but the card has "
            f"[demonstrations] loaded_set = {card.demonstrations.loaded_set}: declare the set, and submit policies of "
            "one set only"
        )


def _check_episode(episode: EpisodeResult, folder: Path, card: Card) -> None:
    """Raises an `EvaluationError` if an entry cannot hold an episode."""
    for name, (usual, problem) in PLAIN.items():
        if (value := getattr(episode, name)) != usual:
            raise EvaluationError(f"{folder} was played {problem.format(value)}")
    if episode.demonstrations and GIVEN not in (card.privileges or ()):
        raise EvaluationError(f'{folder} was played with {episode.given}: add "{GIVEN}" to the card\'s privileges')
    if (episode.task, episode.variant) in places() and (problem := obstacle(episode)):
        raise EvaluationError(f"{folder} cannot be an entry, because it cannot be replayed: {episode.title}: {problem}")
