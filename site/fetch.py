"""Packages from npm in fixed versions: fetched once into out/npm, and only if they are the bytes that we know."""

from __future__ import annotations

import base64
import hashlib
import shutil
import subprocess
import tarfile
from pathlib import Path
from typing import Final, NamedTuple

CACHE: Final = Path(__file__).parent.parent / "out" / "npm"


class Package(NamedTuple):
    """A package of npm."""

    name: str
    version: str
    sha512: str
    """Of its archive, in base64, as npm states it."""


MUJOCO: Final = Package(
    "@mujoco/mujoco",
    "3.14.0",
    "WPUYidu4Fx8+uM4hQv80SOA0ifpWGrsNJguKs8JBV8SCTxjKQ2/rqsh880nUH0/Vwa8vuefghvCQkkoed3bkUg==",
)
"""MuJoCo's own WebAssembly build; Apache-2.0."""
PLAYWRIGHT: Final = Package(
    "playwright-core",
    "1.65.1",
    "hqPpz7blSMPxWVdoeE1yiBSzXsKiVOd2k+kjCvmUywD2GPO2Dd9HfcWnq9NN0GHbNZDFgZ9JfBFr+X5/BLo0qw==",
)
"""Drives the browser in the tests; Apache-2.0."""


def fetched(package: Package) -> Path:
    """The folder with the package's files, fetched by npm if it is not there yet.

    Raises:
        SystemExit: if npm is missing or fails, or sends something else.
    """
    folder = CACHE / "node_modules" / package.name
    if _is(folder, package):
        return folder
    if shutil.which("npm") is None:
        raise SystemExit("the site needs npm (node 20 or newer): apt-get install npm")
    CACHE.mkdir(parents=True, exist_ok=True)
    command = ["npm", "pack", "--silent", f"{package.name}@{package.version}"]
    done = subprocess.run(command, cwd=CACHE, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"npm could not fetch {package.name} {package.version}: {done.stderr.strip()}")
    archive = CACHE / done.stdout.split()[-1]
    digest = base64.b64encode(hashlib.sha512(archive.read_bytes()).digest()).decode()
    if digest != package.sha512:
        raise SystemExit(f"{archive} has the SHA-512 {digest}, not {package.sha512}: it is not what was tested")
    shutil.rmtree(folder, ignore_errors=True)
    unpacked = CACHE / f"{archive.name}.unpacked"
    with tarfile.open(archive) as tar:
        tar.extractall(unpacked, filter="data")
    folder.parent.mkdir(parents=True, exist_ok=True)
    (unpacked / "package").rename(folder)
    unpacked.rmdir()
    (folder / ".sha512").write_text(package.sha512)
    return folder


def _is(folder: Path, package: Package) -> bool:
    """Whether the folder was unpacked from just this archive."""
    mark = folder / ".sha512"
    return mark.exists() and mark.read_text() == package.sha512


if __name__ == "__main__":  # for the tests in JavaScript, which import it
    fetched(PLAYWRIGHT)
