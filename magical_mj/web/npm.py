"""The pages' npm packages: MuJoCo's WebAssembly build, and drawing libraries, in fixed versions.

Each package is fetched once. Its archive is used only if it has the expected hash.
"""

from __future__ import annotations

import base64
import hashlib
import shutil
import subprocess
import tarfile
from pathlib import Path
from typing import Final, NamedTuple

from magical_mj.utils.errors import MagicalError
from magical_mj.utils.files import cache_folder


class Package(NamedTuple):
    """An npm package."""

    name: str
    version: str
    sha512: str
    """The hash of its archive, in base64, as published by npm."""


MUJOCO: Final = Package(
    "@mujoco/mujoco",
    "3.14.0",
    "WPUYidu4Fx8+uM4hQv80SOA0ifpWGrsNJguKs8JBV8SCTxjKQ2/rqsh880nUH0/Vwa8vuefghvCQkkoed3bkUg==",
)
"""MuJoCo's official WebAssembly build; Apache-2.0."""
THREE: Final = Package(
    "three",
    "0.187.0",
    "Qiu7R+Cmh8CstZsY1uJOSWnVlfo7ZtNLV7mF8Jltk3LB3AtDu9cRZlcnRKkAk8Y4z6KKw35z7Y7Urd7jWY8etA==",
)
"""three.js, which draws solids; MIT."""
UPLOT: Final = Package(
    "uplot",
    "1.6.32",
    "KIMVnG68zvu5XXUbC4LQEPnhwOxBuLyW1AHtpm6IKTXImkbLgkMy+jabjLgSLMasNuGGzQm/ep3tOkyTxpiQIw==",
)
"""uPlot, which draws values over time; MIT."""
FILES: Final = {
    "mujoco/mujoco.js": (MUJOCO, "mujoco.js"),
    "mujoco/mujoco.wasm": (MUJOCO, "mujoco.wasm"),
    "three/three.module.js": (THREE, "build/three.module.js"),
    "three/three.core.js": (THREE, "build/three.core.js"),
    "three/OrbitControls.js": (THREE, "examples/jsm/controls/OrbitControls.js"),
    "three/uPlot.esm.js": (UPLOT, "dist/uPlot.esm.js"),
    "three/uPlot.min.css": (UPLOT, "dist/uPlot.min.css"),
}
"""The name of a file for the pages -> its package, and its path in the package."""


def library_files(cache: Path | None = None) -> dict[str, bytes]:
    """The files of `FILES`, by the names that the pages use. `cache` is the folder of packages; None: the user's.

    Raises:
        MagicalError: for the reasons given by `fetched`.
    """
    files = {name: (fetched(package, cache) / path).read_bytes() for name, (package, path) in FILES.items()}
    controls = "three/OrbitControls.js"  # it imports three.js by a name that only bundlers resolve
    files[controls] = files[controls].replace(b"from 'three'", b"from './three.module.js'")
    return files


def fetched(package: Package, cache: Path | None = None) -> Path:
    """The folder with the package's files. npm fetches the package if it is not in the cache.

    Raises:
        MagicalError: if npm is missing or fails, or the archive has another hash.
    """
    cache = cache or cache_folder() / "npm"
    folder = cache / "node_modules" / package.name
    mark = folder / ".sha512"  # the hash of the archive that was unpacked there
    if mark.exists() and mark.read_text() == package.sha512:
        return folder
    if shutil.which("npm") is None:
        raise MagicalError(f"{package.name} {package.version} must be fetched once by npm: install node 20 or newer")
    cache.mkdir(parents=True, exist_ok=True)
    command = ["npm", "pack", "--silent", f"{package.name}@{package.version}"]
    done = subprocess.run(command, cwd=cache, capture_output=True, text=True, check=False)
    if done.returncode:
        raise MagicalError(f"npm could not fetch {package.name} {package.version}: {done.stderr.strip()}")
    archive = cache / done.stdout.split()[-1]
    digest = base64.b64encode(hashlib.sha512(archive.read_bytes()).digest()).decode()
    if digest != package.sha512:
        raise MagicalError(f"{archive} has the SHA-512 {digest}, not {package.sha512}: it is not the tested version")
    shutil.rmtree(folder, ignore_errors=True)
    unpacked = cache / f"{archive.name}.unpacked"
    with tarfile.open(archive) as tar:
        tar.extractall(unpacked, filter="data")
    folder.parent.mkdir(parents=True, exist_ok=True)
    (unpacked / "package").rename(folder)
    unpacked.rmdir()
    mark.write_text(package.sha512)
    archive.unlink()
    return folder
