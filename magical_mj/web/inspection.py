"""The server of `magical-mj inspect`. Its page shows the models of the benchmark's scenes, or of one file."""

from __future__ import annotations

import os
import posixpath
from collections.abc import Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path, PurePosixPath
from typing import Any, ClassVar, Final
from xml.parsers import expat

from magical_mj.engine import Engine
from magical_mj.engine.export import mjcf_text
from magical_mj.tasks.registry import ENVIRONMENTS
from magical_mj.utils import files
from magical_mj.utils.errors import MagicalError, SettingsError
from magical_mj.web.npm import library_files
from magical_mj.web.page_data import sample_models
from magical_mj.web.server import PlayServer

FOLDERS: Final = ("meshdir", "texturedir", "assetdir")
"""The attributes of models that name the folders of their files."""
MOST_OF_MODEL: Final = 200_000_000
"""The largest size in bytes of a model with all its files. The browser keeps them in memory."""
MOST_FILES, MOST_PLACES = 3_000, 30
"""The largest numbers of files that a model refers to, and of folders in its compiler settings."""


@dataclass
class InspectServer(PlayServer):
    """Serves `inspect.html` and its libraries, under a secret address like the page for playing.

    Args:
        model: path -> content, as from `model_files`: first the file that the page shows, then the files that it
            refers to. If it is empty, the page shows scenes of the benchmark.

    Raises:
        MagicalError: if the libraries cannot be fetched.
    """

    model: dict[str, bytes] = field(default_factory=dict)
    scripts: ClassVar[str] = "'self' 'unsafe-eval'"
    """MuJoCo's JavaScript generates functions."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._files |= library_files()
        self._files |= {f"samples/{name}.xml": text.encode() for name, text in sample_models().items()}
        self._files |= {f"model/{number}": content for number, content in enumerate(self.model.values())}

    def _catalogue(self) -> dict[str, Any]:
        name, *files = self.model or [""]
        return super()._catalogue() | ({"model": {"name": name, "files": files}} if name else {})

    def _content(self, name: str) -> bytes | None:
        if not name.startswith("models/"):
            return super()._content(name)
        task, variant, seed = [*name.removeprefix("models/").removesuffix(".xml").split("-"), "", ""][:3]
        if (task, variant) not in ENVIRONMENTS or not seed.isascii() or not seed.isdigit():
            return None
        try:
            with closing(Engine(task, variant, seed=int(seed))) as engine:
                return mjcf_text(engine).encode()
        except (MagicalError, ValueError):  # too large a seed
            return None


def model_files(path: Path, folders: Sequence[Path] = ()) -> dict[str, bytes]:
    """A model and the files that it refers to, by their paths as MuJoCo looks for them. The model comes first.

    Only files in `<include>`, meshes, textures, height fields and skins are read, and only below the model's folder.
    Models that cannot be parsed are sent to the page unchanged. It shows the errors of MuJoCo's compiler.

    Args:
        path: the model.
        folders: other folders whose files the model may use.

    Raises:
        OSError: if the model cannot be read.
        SettingsError: if the model refers to a file elsewhere, to too many files, or the total size is too large.
    """
    roots = [folder.resolve() for folder in (path.parent, *folders)]
    contents = {path.name: files.read_foreign(path, most=MOST_OF_MODEL, error=SettingsError)}
    most = MOST_OF_MODEL - len(contents[path.name])
    waiting, places, named = [path.name], [PurePosixPath()], 0
    while waiting:
        names, further = _references(contents[waiting.pop()])
        places += [place for place in map(PurePosixPath, further) if place not in places]
        named += len(names)
        if named > MOST_FILES or len(places) > MOST_PLACES:
            raise SettingsError(f"{path} refers to more than {MOST_FILES:,} files, or {MOST_PLACES} folders")
        for name in names:
            found = _found(path.parent, name, places, roots)
            if found is None or (known := str(found)) in contents:
                continue
            if (path.parent / found).stat().st_size > most:
                raise SettingsError(f"{path} and the files that it refers to have more than {MOST_OF_MODEL:,} bytes")
            contents[known] = files.read_foreign(path.parent / found, most=most, error=SettingsError)
            most -= len(contents[known])
            if found.suffix == ".xml":
                waiting.append(known)
    return contents


def _references(content: bytes) -> tuple[list[str], list[str]]:
    """The files that a model names, and the folders of its compiler settings. No elements are kept in memory."""
    names, places = dict[str, None](), dict[str, None]()

    def start(tag: str, attributes: dict[str, str]) -> None:
        if attributes.get("file"):
            names[attributes["file"]] = None
        if tag == "compiler":
            places.update(dict.fromkeys(attributes[key] for key in FOLDERS if key in attributes))

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    with suppress(expat.ExpatError):
        parser.Parse(content, True)
    return list(names), list(places)


def _found(start: Path, name: str, places: Sequence[PurePosixPath], roots: Sequence[Path]) -> PurePosixPath | None:
    """The path, relative to `start`, of the first file with this name in one of the places. None if there is none.

    Raises:
        SettingsError: if this file is not below the `roots`, also after symbolic links.
    """
    for place, ending in product(places, (name, PurePosixPath(name).name)):  # strippath="true" removes folders
        candidate = PurePosixPath(posixpath.normpath(place / ending))  # as MuJoCo does, before links are followed
        real = Path(os.path.realpath(start / candidate))
        if not any(real.is_relative_to(root) for root in roots):
            if os.path.lexists(start / candidate):
                raise SettingsError(
                    f"the model refers to {candidate}, which is not below its folder; to allow it, name its folder: "
                    f"--folder {real.parent}"
                )
        elif real.is_file():
            return candidate
    return None
