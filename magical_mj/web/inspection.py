"""The server of `magical-mj inspect`. Its page shows the models of the benchmark's scenes, or of one file."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Final
from xml.etree import ElementTree as ET

from magical_mj.engine import Engine
from magical_mj.engine.export import mjcf_text
from magical_mj.tasks.registry import ENVIRONMENTS
from magical_mj.utils.errors import MagicalError, SettingsError
from magical_mj.web.npm import library_files
from magical_mj.web.page_data import sample_models
from magical_mj.web.server import PlayServer

FOLDERS: Final = ("meshdir", "texturedir", "assetdir")
"""The attributes of models that name the folders of their files."""
MOST_OF_MODEL: Final = 200_000_000
"""The largest size in bytes of a model with all its files. The browser keeps them in memory."""


@dataclass
class InspectServer(PlayServer):
    """Serves `inspect.html` and its libraries, under a secret address like the page for playing.

    Args:
        model: file name -> content: first the file that the page shows, then the files that it refers to. If it is
            empty, the page shows scenes of the benchmark.

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
        self._files |= {f"model/{name}": content for name, content in self.model.items()}

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


def model_files(path: Path) -> dict[str, bytes]:
    """A model and the files that it refers to, by their file names. The model comes first.

    Only files in `<include>`, meshes, textures, height fields and skins are read. Models that cannot be parsed are sent
    to the page unchanged. It shows the errors of MuJoCo's compiler.

    Raises:
        OSError: if the model cannot be read.
        SettingsError: if the total size is too large.
    """
    contents = {path.name: path.read_bytes()}
    waiting = [path.name]
    folders = {path.parent}
    while waiting:
        try:
            root = ET.fromstring(contents[waiting.pop()])  # noqa: S314 (the user's own file)
        except ET.ParseError:
            continue
        named = [element.get("file", "") for element in root.iter() if element.get("file")]
        folders |= {path.parent / element.get(key, "") for element in root.iter("compiler") for key in FOLDERS}
        for name in named:
            found = next((folder / name for folder in sorted(folders) if (folder / name).is_file()), None)
            if found is None or found.name in contents:
                continue
            contents[found.name] = found.read_bytes()
            if found.suffix == ".xml":
                waiting.append(found.name)
            if sum(map(len, contents.values())) > MOST_OF_MODEL:
                raise SettingsError(f"{path} and the files that it refers to have more than {MOST_OF_MODEL:,} bytes")
    return contents
