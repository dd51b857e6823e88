"""Exports demonstrations to folders: WebDataset archives for streaming, and pictures for XIRL.

A WebDataset archive contains the observations before and after each action, no pickles, and comes with a data card.
"""

from __future__ import annotations

import gzip
import io
import json
import tarfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from PIL import Image

from magical_mj.actions import ACTIONS
from magical_mj.demos.demonstration import Demonstration, demonstrators, group_name
from magical_mj.demos.learning import environment_of, observations
from magical_mj.demos.recording import render_demo
from magical_mj.protocol import DEMONSTRATIONS, PROTOCOL
from magical_mj.scene.constants import CONTROL_RATE
from magical_mj.tasks.registry import task_spec
from magical_mj.utils import files
from magical_mj.utils.errors import DemonstrationError

ARCHIVE: Final = "data-000000.tar.gz"
CARD: Final = "README.md"
FEATURES: Final[Mapping[str, str]] = {
    "obs, next_obs": "the observation before and after the action",
    "acts": f"the action, uint8 in 0..{len(ACTIONS) - 1}",
    "dones": "bool: whether it is the last action of the episode",
}

EACH: Final = "`gymnasium.make(magical_mj.env_id(task, variant, preset))` with the task and variant of each episode"
"""The code that makes the environments of several intents."""
MAKERS: Final[Mapping[str, str]] = {
    "expert": "by the scripted expert of magical_mj, which knows the state",
    "human": "by people who drove the robot in magical_mj",
    "diverse": "by the scripted expert, which knows the state, in varied styles",
    "random": "by actions drawn independently and uniformly",
    "policy": "by a policy",
    "stopped": "by the expert, stopped at a random step",
    "disturbed": "by the expert, with random actions in between",
    "mistaken": "by the expert, with a wrong goal",
}
"""Demonstrator -> the origin of the episodes."""
XIRL_SIZE: Final = 384
"""Pixels per side, the same as in x-magical."""
XIRL_VALID: Final = 10
"""One in this number of videos of a body is used for validation."""


def to_webdataset(
    demos: Sequence[Demonstration], folder: Path | str, preset: str = "LoRes4E", *, overwrite: bool = False
) -> Path:
    """Writes a folder with a WebDataset archive of demonstrations, and a data card. Returns the archive's path.

    The archive's first record has the key ``_metadata`` and one file, ``json``. Each other record is a transition. Its
    key is such as ``003-0017`` for step 17 of episode 3. Its files are ``obs.npy``, ``next_obs.npy``, ``acts.npy`` and
    ``dones.npy``. Presets with dict observations have a file for each name, such as ``obs.ego.npy``.

    Args:
        demos: demonstrations of one environment.
        folder: the new folder.
        preset: the Gymnasium preset of the observations.
        overwrite: replace an existing folder.

    Raises:
        DemonstrationError: if the demonstrations are not of one environment.
        FileExistsError: if the folder exists.
    """
    folder = files.to_path(folder)
    facts = about(demos)
    made_in, gymnasium = EACH, {}
    if "tasks" not in facts:
        name, kwargs = environment_of(demos[0], preset)
        arguments = ", ".join([f'"{name}"', *(f"{key}={value!r}" for key, value in kwargs.items())])
        made_in, gymnasium = f"`gymnasium.make({arguments})`", {"gymnasium": {"id": name, "kwargs": kwargs}}
    metadata = {**facts, "preset": preset, **gymnasium, "features": dict(FEATURES)}
    with files.new_folder(folder, overwrite=overwrite) as unfinished:
        unfinished.mkdir()
        with (
            (unfinished / ARCHIVE).open("wb") as file,
            gzip.GzipFile("", "wb", 6, file, mtime=0) as packed,  # without a time, so that the bytes are reproducible
            tarfile.open(fileobj=packed, mode="w") as archive,
        ):
            _add(archive, "_metadata.json", json.dumps(metadata, indent=1).encode())
            for number, demo in enumerate(demos):
                for step, parts in enumerate(_transitions(demo, preset)):
                    for name, value in parts.items():
                        content = io.BytesIO()
                        np.save(content, value, allow_pickle=False)
                        _add(archive, f"{number:03}-{step:04}.{name}.npy", content.getvalue())
        text = card(facts, demos[0].task, f"the preset {preset}", made_in, FEATURES)
        (unfinished / CARD).write_text(text, encoding="utf-8")
    return folder / ARCHIVE


def about(demos: Sequence[Demonstration]) -> dict[str, Any]:
    """The metadata of demonstrations. Raises a `DemonstrationError` if they are not of one environment."""
    return {
        "environment": group_name(demos),
        **_intents(demos),
        "demonstrators": demonstrators(demos),
        "episodes": len(demos),
        "steps": sum(len(demo.actions) for demo in demos),
        "scene_seeds": [demo.scene_seed for demo in demos],
        "scores": [demo.score for demo in demos],
        "protocol": PROTOCOL,
        "demonstrations": DEMONSTRATIONS,
        "magical_mj": sorted({demo.package for demo in demos}),
        "mujoco": sorted({demo.mujoco for demo in demos}),
        "digests": [demo.digest for demo in demos],
    }


def _intents(demos: Sequence[Demonstration]) -> dict[str, Any]:
    """The task, variant and sentence of each demonstration, if they are of several intents. Otherwise empty."""
    if len({demo.task for demo in demos}) == 1:
        return {}
    return {
        "tasks": [demo.task for demo in demos],
        "variants": [demo.variant for demo in demos],
        "sentences": [task_spec(demo.task).instruction for demo in demos],
    }


def card(facts: Mapping[str, Any], task: str, observed: str, made_in: str, features: Mapping[str, str]) -> str:
    """The data card of demonstrations: Markdown with the header of data set hubs.

    Args:
        facts: the metadata, from `about`.
        task: the task of the environment; if it is one of several intents, it does not matter.
        observed: a description of the observations.
        made_in: the code or options that create the environment.
        features: a description of each name in the data.
    """
    noun = "demonstrations" if {"expert", "human"}.issuperset(facts["demonstrators"]) else "episodes"
    made = " and ".join(MAKERS[name] for name in facts["demonstrators"])
    rows = "\n".join(f"| `{name}` | {meaning} |" for name, meaning in features.items())
    several = "tasks" in facts
    goal = f"{len(set(facts['tasks']))} intents" if several else task_spec(task).summary
    scenes = "each intent" if several else "this environment"
    scenes_of_demo = "successive seeds have the intent's demo scenes in turn" if several else "all scenes are equal"
    seeds = f"{min(facts['scene_seeds'])} to {max(facts['scene_seeds'])}"
    return f"""---
license: apache-2.0
task_categories: [robotics]
tags: [imitation-learning, magical, mujoco]
---
# {facts["environment"]}: {facts["episodes"]} {noun}

{goal}: {facts["episodes"]} episodes, {facts["steps"]} steps of 1/{CONTROL_RATE} s, scores \
{min(facts["scores"]):.2f} to {max(facts["scores"]):.2f}.

| Feature | Content |
| --- | --- |
{rows}

- **Observations**: {observed}.
- **Environment**: {made_in}, reset with the scenes' seeds.
- **Origin**: {made}. The actions reproduce the episodes exactly. MuJoCo {", ".join(facts["mujoco"])}, magical_mj \
{", ".join(facts["magical_mj"])}.
- **Scenes**: the seeds {seeds} of {scenes}, protocol {PROTOCOL}. In Demo {scenes_of_demo}. Test scenes are
  the seeds 0 to 99 of the other variants.
- **Licence**: Apache-2.0. Only episodes by the demonstrator `human` record the actions of people.
"""


def _transitions(demo: Demonstration, preset: str) -> Iterator[dict[str, Any]]:
    rows = observations(demo, preset)
    views = {f".{view}": part for view, part in rows.items()} if isinstance(rows, dict) else {"": rows}
    for step, action in enumerate(demo.actions):
        yield {
            **{f"obs{view}": part[step] for view, part in views.items()},
            **{f"next_obs{view}": part[step + 1] for view, part in views.items()},
            "acts": action,
            "dones": np.bool_(step + 1 == len(demo.actions)),
        }


def _add(archive: tarfile.TarFile, name: str, content: bytes) -> None:
    member = tarfile.TarInfo(name)
    member.size = len(content)
    archive.addfile(member, io.BytesIO(content))


def to_xirl(demos: Sequence[Demonstration], folder: Path | str, *, overwrite: bool = False) -> None:
    """Renders demonstrations of one task into a new folder, as training data of XIRL (Zakka et al. 2021).

    XIRL's loader reads ``ROOT/train/BODY/VIDEO/FRAME.png`` and ``ROOT/valid/...``, with numbers from 0, and learns
    across bodies. Pictures show the whole workspace before the first and after each action. XIRL scales them to 112 px.
    For each body, the last tenth of the demonstrations, at least one, is for validation.

    Args:
        demos: demonstrations of one task by any bodies.
        folder: the new folder.
        overwrite: replace an existing folder.

    Raises:
        DemonstrationError: if they are of several tasks, or there is only one by a body.
        FileExistsError: if the folder exists.
    """
    tasks = sorted({demo.task for demo in demos})
    if len(tasks) != 1:
        raise DemonstrationError(
            f"a data set for XIRL contains one task, but these are of {', '.join(tasks) or 'none'}"
        )
    groups: dict[str, list[Demonstration]] = {}
    for demo in demos:
        groups.setdefault(demo.scene.robot.body.rpartition(":")[2], []).append(demo)
    for body, group in groups.items():
        if len(group) < 2:
            raise DemonstrationError(
                f"there is only one demonstration by the {body}: training and validation need one each"
            )
    with files.new_folder(files.to_path(folder), overwrite=overwrite) as unfinished:
        for body, group in groups.items():
            trained = len(group) - max(1, len(group) // XIRL_VALID)
            for number, demo in enumerate(group):
                split, video = ("train", number) if number < trained else ("valid", number - trained)
                _draw(demo, unfinished / split / body / str(video))


def _draw(demo: Demonstration, folder: Path) -> None:
    folder.mkdir(parents=True)
    for frame, pictures in enumerate(render_demo(demo, size=XIRL_SIZE, renderer="software")):
        Image.fromarray(pictures["allo"]).save(folder / f"{frame}.png")
