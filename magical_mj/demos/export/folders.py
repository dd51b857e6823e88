"""Demonstrations as folders: WebDataset archives, which stream, with a data card as in LeRobot's; and XIRL's pictures.

An archive needs no library to be written, and holds no pickles. What learners of representations read is there: the
observation before and after each action.
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

from magical_mj.demos.demonstration import Demonstration, demonstrators, only_environment
from magical_mj.demos.export.source import source_of
from magical_mj.demos.learning import observations
from magical_mj.demos.recording import render_demo
from magical_mj.scene.actions import ACTIONS
from magical_mj.scene.constants import CONTROL_RATE
from magical_mj.tasks.protocol import DEMONSTRATIONS, PROTOCOL
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

MAKERS: Final[Mapping[str, str]] = {
    "expert": "by the scripted expert of magical_mj, which knows the state",
    "human": "by people who drove the robot in magical_mj",
    "random": "by actions drawn independently and uniformly",
    "policy": "by a policy that somebody gave",
}
"""Demonstrator -> how the episodes were made."""
XIRL_SIZE: Final = 384
"""Pixels per side, as x-magical draws them."""
XIRL_VALID: Final = 10
"""The last of so many videos of a body are for validation."""


def to_webdataset(
    demos: Sequence[Demonstration], folder: Path | str, preset: str = "LoRes4E", *, overwrite: bool = False
) -> Path:
    """Makes a folder with an archive, whose path is returned, and a data card of demonstrations of one environment.

    The archive's first record has the key ``_metadata`` and one part, ``json``. Each other one is a transition, with
    keys such as ``003-0017`` for step 17 of episode 3 and the parts ``obs.npy``, ``next_obs.npy``, ``acts.npy`` and
    ``dones.npy``; presets with several parts have one for each, such as ``obs.ego.npy``. Raises a `DemonstrationError`
    if the demonstrations are not of one environment, and a `FileExistsError` if the folder exists.
    """
    folder = files.to_path(folder)
    facts = about(demos)
    source = source_of(demos[0], preset)
    metadata = {**facts, "preset": preset, "gymnasium": source._asdict(), "features": dict(FEATURES)}
    with files.new_folder(folder, overwrite=overwrite) as unfinished:
        unfinished.mkdir()
        with (
            (unfinished / ARCHIVE).open("wb") as file,
            gzip.GzipFile("", "wb", 6, file, mtime=0) as packed,  # the same bytes at any time
            tarfile.open(fileobj=packed, mode="w") as archive,
        ):
            _add(archive, "_metadata.json", json.dumps(metadata, indent=1).encode())
            for number, demo in enumerate(demos):
                for step, parts in enumerate(_transitions(demo, preset)):
                    for name, value in parts.items():
                        content = io.BytesIO()
                        np.save(content, value, allow_pickle=False)
                        _add(archive, f"{number:03}-{step:04}.{name}.npy", content.getvalue())
        made_in = f"`gymnasium.make({source})`"
        (unfinished / CARD).write_text(card(demos, f"the preset {preset}", made_in, FEATURES), encoding="utf-8")
    return folder / ARCHIVE


def about(demos: Sequence[Demonstration]) -> dict[str, Any]:
    """What a data set's metadata say of its demonstrations, which are of one environment."""
    return {
        "environment": only_environment(demos),
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


def card(demos: Sequence[Demonstration], observed: str, made_in: str, features: Mapping[str, str]) -> str:
    """The data card of demonstrations of one environment, Markdown with the header that hubs of data sets read.

    `observed` says in words what the observations are, `made_in` how to make the environment, and `features` what each
    name in the data holds.
    """
    facts, spec = about(demos), task_spec(demos[0].task)
    what = "demonstrations" if {"expert", "human"}.issuperset(facts["demonstrators"]) else "episodes"
    made = " and ".join(MAKERS[name] for name in facts["demonstrators"])
    rows = "\n".join(f"| `{name}` | {meaning} |" for name, meaning in features.items())
    seeds = f"{min(facts['scene_seeds'])} to {max(facts['scene_seeds'])}"
    return f"""---
license: apache-2.0
task_categories: [robotics]
tags: [imitation-learning, magical, mujoco]
---
# {facts["environment"]}: {facts["episodes"]} {what}

{spec.summary}: {facts["episodes"]} episodes, {facts["steps"]} steps of 1/{CONTROL_RATE} s, scores \
{min(facts["scores"]):.2f} to {max(facts["scores"]):.2f}.

| Feature | Holds |
| --- | --- |
{rows}

- **Observations**: {observed}.
- **Environment**: {made_in}, reset with the scenes' seeds.
- **How made**: {made}; replayed exactly from the actions. MuJoCo {", ".join(facts["mujoco"])}, magical_mj \
{", ".join(facts["magical_mj"])}.
- **Scenes**: of the seeds {seeds} of this environment, protocol {PROTOCOL}. In Demo all scenes are the same one;
  tests are played in the seeds 0 to 99 of the other variants.
- **Licence**: Apache-2.0. No people were recorded, unless the demonstrators are `human`.
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
    """Draws demonstrations of one task, by any bodies, into a new folder on which XIRL (Zakka et al. 2021) trains.

    Its loader reads ``ROOT/train/BODY/VIDEO/FRAME.png`` and ``ROOT/valid/...``, all numbered from 0, and learns across
    the bodies. Pictures are of the whole workspace, before the first action and after each; XIRL scales them down to
    112 px. Each body's first nine of ten demonstrations are for training. Raises a `DemonstrationError` if they are of
    several tasks, or a body has a single one.
    """
    tasks = sorted({demo.task for demo in demos})
    if len(tasks) != 1:
        raise DemonstrationError(f"a data set for XIRL holds one task, and these are of {', '.join(tasks) or 'none'}")
    groups: dict[str, list[Demonstration]] = {}
    for demo in demos:
        groups.setdefault(demo.scene.robot.body.rpartition(":")[2], []).append(demo)
    for body, group in groups.items():
        if len(group) < 2:
            raise DemonstrationError(f"there is one demonstration by the {body}: training and validation need one each")
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
