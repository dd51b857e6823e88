"""Demonstrations: recorded episodes, and their files.

A file is a zip archive of numpy arrays, which `numpy.load` opens without pickle. `header.npy` contains JSON as bytes:
all fields that are not arrays, the format's version, and a SHA-256 digest of everything else. `actions.npy`, `qpos.npy`
and `qvel.npy` are the arrays. Files are written completely or not at all, and never overwritten. Files may come from an
untrusted source. So reading limits their size, imports nothing, and checks all their content.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import itertools
import json
import re
import warnings
import zipfile
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from magical_mj._version import __version__
from magical_mj.actions import ACTIONS, NOOP, as_speeds
from magical_mj.assets.robot import joints
from magical_mj.assets.scene_model import SceneModel
from magical_mj.scene import Scene
from magical_mj.scene.bodies import GRIPPER, body_named
from magical_mj.shifts.registry import PHYSICAL, axis_and_level, parse_shifts, shift_label
from magical_mj.tasks import KNOWN
from magical_mj.tasks.languages import in_language
from magical_mj.tasks.registry import (
    announced_name,
    environment_axes,
    sample_scene,
    score_trajectory,
    task_spec,
    variant_name,
)
from magical_mj.utils import files
from magical_mj.utils.errors import DemonstrationError, MagicalError, UntrustedNameError, short_repr
from magical_mj.utils.imports import check_named
from magical_mj.utils.settings import annotated, fitting

Demonstrator = Literal["expert", "human", "random", "policy", "stopped", "disturbed", "mistaken", "diverse"]
Seed = Annotated[int, Meta(ge=0)]

FORMAT: Final = 1
SUFFIX: Final = ".npz"
ARRAYS: Final = ("actions", "qpos", "qvel")
MOST_BYTES: Final = 50_000_000
"""The maximum size of a file, and of its unpacked content. The longest shipped demonstrations have 200,000 bytes."""
COMPRESSIONS: Final = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""The compressions that numpy writes. Python's readers of them never unpack more than the declared size."""


@dataclass(frozen=True, eq=False)
class Demonstration:
    """An episode: its initial scene, the actions, and the states before the first and after each action."""

    task: str
    variant: str
    scene_seed: Seed
    """`scene` is `sample_scene(task, variant, scene_seed)`, changed by `shifts`."""
    demonstrator: Demonstrator
    seed: Seed
    """The seed of the expert. For other demonstrators, that of the scene."""
    scene: Scene
    actions: NDArray[Any]
    """Action numbers, uint8, shape (steps,). In tasks with speeds, such as SweepToTop, float32, (steps, 2 or 3)."""
    qpos: NDArray[np.float64]
    """MuJoCo's positions, shape (steps + 1, nq)."""
    qvel: NDArray[np.float64]
    """MuJoCo's velocities, shape (steps + 1, nv)."""
    score: Annotated[float, Meta(ge=0, le=1)]
    """The score of the last state under the paper's rules."""
    package: str = __version__
    mujoco: str = version("mujoco")
    shifts: str = ""
    """Physical shifts, such as ``"clutter:3"``. `actions` are the commanded ones. Files leave it out if it is empty."""

    @property
    def name(self) -> str:
        """The names of the task and the variant, then of the body and the shifts, if it has any.

        Examples: ``"FindDupe-Demo"``, ``"SweepToTop-Layout-longstick"``.
        """
        body = self.scene.robot.body
        others = ("" if body == GRIPPER else body, self.shifts.replace(":", ""))
        return "-".join(filter(None, (task_spec(self.task).name, self.variant, *others)))

    @property
    def digest(self) -> str:
        """The SHA-256 digest of all content, as in its file."""
        return header_and_arrays(self)[0]["digest"]

    @property
    def acts(self) -> NDArray[np.bool_]:
        """Whether each action is not the no-op. For speeds, whether it drives or turns. Shape (steps,)."""
        return np.asarray(self.actions != NOOP if self.actions.ndim == 1 else self.actions[:, :2].any(axis=1))

    @property
    def is_current(self) -> bool:
        """Whether it starts in the scene of its variant and seed. If not, the task has changed since it was made.

        True with shifts, which `verify` checks.
        """
        drawn = (self.task, self.variant, self.scene_seed, self.scene.robot.body)
        return bool(self.shifts) or self.scene == sample_scene(*drawn)

    def scenes(self) -> list[Scene]:
        """The scenes before the first and after each action."""
        model = SceneModel(self.scene)
        return [model.read(qpos) for qpos in self.qpos]

    def ends(self) -> tuple[Scene, Scene]:
        """The scenes before the first and after the last action."""
        model = SceneModel(self.scene)
        return model.read(self.qpos[0]), model.read(self.qpos[-1])

    def rescored(self, step: int | None = None) -> float:
        """The score after this number of steps, computed from the states. None: at the end."""
        model, last = SceneModel(self.scene), len(self.actions) if step is None else step
        first = 1 if task_spec(self.task).trajectory else last
        return score_trajectory(self.task, (self.scene, *map(model.read, self.qpos[first : last + 1])))


HEADER_FIELDS: Final = {name: kind for name, kind in annotated(Demonstration).items() if name not in (*ARRAYS, "scene")}
"""The fields in a file's header except the scene, with their types and bounds."""


def write(demo: Demonstration, path: Path | str) -> None:
    """Writes a demonstration to a new file (`*.npz`). A missing folder is created.

    Raises:
        DemonstrationError: if the name does not end in .npz, or the arrays of the demonstration are inconsistent.
        SettingsError: if another field has a wrong type or value.
        FileExistsError: if the file exists. Nothing is overwritten.
    """
    path = files.to_path(path)
    if path.suffix != SUFFIX:
        raise DemonstrationError(f"the name of a demonstration's file must end in {SUFFIX}, unlike {path}")
    header, arrays = header_and_arrays(demo)
    path.parent.mkdir(parents=True, exist_ok=True)
    archive = io.BytesIO()
    text = np.frombuffer(json.dumps(header).encode(), np.uint8)
    np.savez_compressed(archive, allow_pickle=False, header=text, **arrays)
    files.write(path, archive.getvalue())


def header_and_arrays(demo: Demonstration) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """The content of a demonstration's file: the header with the digest, and the arrays. Errors: see `write`."""
    fields = _checked_fields(vars(demo))
    _check_arrays(demo)
    arrays = {name: getattr(demo, name) for name in ARRAYS}
    header = {"format": FORMAT, **fields, "scene": json.loads(demo.scene.to_json())}
    return {**header, "digest": _digest(header, arrays)}, arrays


def keep(demo: Demonstration, folder: Path | str) -> tuple[Path, bool]:
    """Writes a demonstration into a folder under the next free name, such as ``FindDupe-All-human-003.npz``.

    Damaged files in the folder do not prevent it.

    Returns:
        The path, and whether a file was written. If the folder contains the same episode already, nothing is written,
        and the path is that of the existing file.

    Raises:
        OSError: if the file cannot be written.
    """
    folder = files.to_path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    beginning = f"{demo.name}-{demo.demonstrator}-"
    for path in sorted(folder.glob(f"{beginning}*{SUFFIX}")):
        with contextlib.suppress(Exception):  # no error of another file may prevent saving this episode
            other = read(path, demo.task, trusted=[demo.scene.robot.body])
            if (other.scene_seed, other.actions.tobytes()) == (demo.scene_seed, demo.actions.tobytes()):
                return path, False
    paths = (folder / f"{beginning}{number:03}{SUFFIX}" for number in itertools.count())
    while True:
        path = next(path for path in paths if not path.exists())
        with contextlib.suppress(FileExistsError):  # another process created the file in the meantime
            write(demo, path)
            return path, True


def files_in(folder: Path | str, beginning: str = "") -> list[Path]:
    """The demonstration files in a folder whose names start with `beginning`, sorted. Unfinished files are left out.

    Files in visible subfolders, such as one for each player, follow them.
    """
    folder = files.to_path(folder)
    pattern = f"{beginning or '[!.]'}*{SUFFIX}"
    return [path for inner in (folder, *sorted(folder.glob("[!.]*/"))) for path in sorted(inner.glob(pattern))]


def read(path: Path | str, task: str | None = None, *, trusted: Collection[str] = ()) -> Demonstration:
    """Reads a demonstration and checks its content.

    If an installed package now names the task of a reference in the file, the demonstration has that name. If the score
    of a user's task has changed since, the demonstration has the new score, and a warning says so.

    Args:
        path: the file.
        task: the expected task. None: any task.
        trusted: references such as "mine:SPEC" that the file may contain, in addition to `task`. See docs/trust.md.

    Raises:
        DemonstrationError: if the file is truncated, altered, of another version or task, larger than `MOST_BYTES`, or
            not a plain file.
        UntrustedNameError: if its task or body is a reference that is not trusted.
        OSError: if the file does not exist or cannot be read.
    """
    path = files.to_path(path)
    arrays = _members(path, files.read_foreign(path, most=MOST_BYTES, error=DemonstrationError))
    return unpacked(path, arrays.pop("header").tobytes(), arrays, task, trusted)


def unpacked(
    path: Path, text: bytes, arrays: Mapping[str, Any], task: str | None, trusted: Collection[str] = ()
) -> Demonstration:
    """The demonstration with this header and these arrays, which were read from `path`. See `read`."""
    header = _header(path, text, arrays)
    if task is not None and header["task"] != announced_name(task):
        raise DemonstrationError(f"{path} is a demonstration of {header['task']}, not of {task}")
    check_named(header["task"], path, (*trusted, *filter(None, [task])))
    try:
        scene = Scene.from_json(json.dumps(header["scene"]), trusted=trusted)
        fields = _checked_fields({**header, "variant": variant_name(header["variant"])})
        demo = Demonstration(**fields, scene=scene, **arrays)
        _check_arrays(demo)
        if demo.task not in KNOWN and not in_language(demo.task) and (score := demo.rescored()) != demo.score:
            warnings.warn(f"the score of {demo.task} has changed: its demonstrations are scored anew", stacklevel=3)
            demo = replace(demo, score=score)
    except UntrustedNameError:
        raise
    except (KeyError, MagicalError) as error:
        raise DemonstrationError(f"{path} does not describe a demonstration: {error}") from error
    return demo


def _members(path: Path, content: bytes) -> dict[str, Any]:
    """The header, an array of bytes, and the other arrays in a file's content."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = archive.infolist()
        size = sum(member.file_size for member in members)
        if size > MOST_BYTES:
            raise DemonstrationError(f"{path} is not read: it unpacks to {size:,} bytes, more than {MOST_BYTES:,}")
        if any(member.compress_type not in COMPRESSIONS for member in members):
            raise DemonstrationError(f"{path} is not read: its compression is not deflate")
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            return {name: arrays[name] for name in ("header", *ARRAYS)}
    except DemonstrationError:
        raise
    except Exception as error:  # zipfile, zlib and numpy raise some fifteen types for damaged archives
        raise DemonstrationError(f"{path} is damaged, truncated, or not a demonstration") from error


def _header(path: Path, text: bytes, arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """The fields of a header, after checking its format and digest. The task has its current name."""
    try:
        header = json.loads(text)
        number, digest = header.get("format"), header.pop("digest", None)
        is_whole = digest == _digest(header, arrays)
    except (ValueError, AttributeError, RecursionError):
        raise DemonstrationError(f"{path} has an unreadable header: it is damaged, or not a demonstration") from None
    if number != FORMAT:
        raise DemonstrationError(
            f"{path} has format {number!r}, but this version of magical_mj reads format {FORMAT}: "
            "read it with the version that wrote it, or generate it again"
        )
    if not is_whole:
        raise DemonstrationError(f"{path} was altered after it was written: its digest does not match its content")
    return {**header, "task": announced_name(header.get("task", ""))}


def _digest(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> str:
    """The SHA-256 digest of the header and the arrays."""
    digest = hashlib.sha256(json.dumps(header, sort_keys=True).encode())
    for name in ARRAYS:
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def _checked_fields(values: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a header, after checking their types and bounds, and that the environment exists."""
    environment_axes(values["task"], values["variant"])
    fields = {name: fitting(name, values[name], kind) for name, kind in HEADER_FIELDS.items() if name != "shifts"}
    if shifts := fitting("shifts", values.get("shifts", ""), str):
        check_physical(shifts)  # before `parse_shifts`, which imports the modules of references
        fields["shifts"] = shift_label(parse_shifts(shifts, values["task"]))
    return fields


def check_physical(shifts: str) -> None:
    """Raises a `DemonstrationError` for shifts of pictures and instructions, which demonstrations do not contain."""
    parts = filter(None, re.split("[,+]", shifts))
    if others := [part for part in parts if axis_and_level(part)[0] not in PHYSICAL]:
        raise DemonstrationError(
            f"a demonstration can have the shifts {', '.join(PHYSICAL)}, not {others[0]}: it contains states, and its "
            "pictures and instructions are made when it is used"
        )


def _check_arrays(demo: Demonstration) -> None:
    """Raises a `DemonstrationError` if the arrays are inconsistent with each other or with the scene."""
    body, speeds = demo.scene.robot.body, task_spec(demo.task).speeds
    shapes = [(array.dtype, array.ndim) for array in (demo.actions, demo.qpos, demo.qvel)]
    if shapes != [(np.float32, 2) if speeds else (np.uint8, 1), (np.float64, 2), (np.float64, 2)]:
        kind = "(steps, n) of float32" if speeds else "(steps,) of uint8"
        raise DemonstrationError(f"actions must be an array {kind}, qpos and qvel arrays (steps + 1, n) of float64")
    steps, coordinates = len(demo.actions), len(joints(body)) + 3 * len((*demo.scene.blocks, *demo.scene.pebbles))
    if steps == 0 or not demo.qpos.shape == demo.qvel.shape == (steps + 1, coordinates):
        raise DemonstrationError(
            f"for {steps} actions in this scene, qpos and qvel must have the shape {(steps + 1, coordinates)}, not "
            f"{demo.qpos.shape} and {demo.qvel.shape}"
        )
    if not (np.isfinite(demo.qpos).all() and np.isfinite(demo.qvel).all() and np.isfinite(demo.actions).all()):
        raise DemonstrationError("actions and states must be finite")
    if speeds:
        as_speeds(demo.actions[0], 3 if body_named(body).fingers else 2)
    elif (demo.actions >= len(ACTIONS)).any():
        raise DemonstrationError(f"actions must be below {len(ACTIONS)}")


def checked(demos: Iterable[Demonstration]) -> Iterator[Demonstration]:
    """Yields the demonstrations that a user gave, after checking their type.

    Raises:
        DemonstrationError: for anything else, such as a single demonstration or a path.
    """
    if not isinstance(demos, Iterable):
        raise DemonstrationError(f"give demonstrations in a list, not {short_repr(demos)}")
    for demo in demos:
        if not isinstance(demo, Demonstration):
            raise DemonstrationError(
                f"{short_repr(demo)} is not a demonstration, such as those of magical_mj.demos.load"
            )
        yield demo


def only_environment(demos: Sequence[Demonstration]) -> str:
    """The name of the environment of all these demonstrations, such as ``"FindDupe-Demo"``.

    Raises:
        DemonstrationError: if they are of several environments, if `demos` is empty, or if it contains other objects.
    """
    names = sorted({demo.name for demo in checked(demos)})
    if len(names) != 1:
        given = f"these are of {', '.join(names)}" if names else "none were given"
        raise DemonstrationError(f"a data set contains demonstrations of one environment, but {given}")
    return names[0]


def group_name(demos: Sequence[Demonstration]) -> str:
    """The name of the environment of all these demonstrations, or for several intents such as ``"Intents-Demo"``.

    Raises:
        DemonstrationError: see `only_environment`. Demonstrations of several intents are allowed.
    """
    if len({demo.task for demo in checked(demos)}) > 1 and all(in_language(demo.task) for demo in demos):
        return "-".join(("Intents", *sorted({demo.variant for demo in demos})))
    return only_environment(demos)


def check_seeds(demos: Sequence[Demonstration]) -> None:
    """Checks seeds for file formats with 64-bit integers.

    Raises:
        DemonstrationError: if a scene's seed is 2**63 or larger.
    """
    for demo in demos:
        if demo.scene_seed >= 2**63:
            raise DemonstrationError(
                f"the scene's seed {short_repr(demo.scene_seed)} does not fit the 64-bit integers of this format: "
                "choose demonstrations whose seeds are below 2**63"
            )


def demonstrators(demos: Sequence[Demonstration]) -> list[str]:
    """The different kinds of demonstrators of these demonstrations, sorted."""
    return sorted({demo.demonstrator for demo in demos})
