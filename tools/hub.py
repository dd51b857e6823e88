"""Rehearses an upload to Hugging Face's hub: by its own command, to a stand-in on this machine that fills a folder.

    python tools/hub.py FOLDER [--type dataset] [--out out/hub]

It needs huggingface_hub, no account and no network. The stand-in answers as the hub does about files that are small
enough for git. Everything in the folder must arrive as it is.
"""

from __future__ import annotations

import argparse
import base64
import filecmp
import json
import os
import subprocess
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Final

REPOSITORY: Final = "somebody/rehearsal"


class StandIn(BaseHTTPRequestHandler):
    """Answers what an upload asks, and writes the files of its commits to the folder `out`."""

    out: Path

    def do_GET(self) -> None:
        """Nothing is there yet."""
        self._answer({})

    def do_POST(self) -> None:
        """Makes the repository, says how to send each file, and takes the commit."""
        sent = self.rfile.read(int(self.headers["Content-Length"])).decode()
        if self.path == "/api/repos/create":
            self._answer({"url": REPOSITORY})
        elif "/preupload/" in self.path:
            names = [file["path"] for file in json.loads(sent)["files"]]
            self._answer({"files": [{"path": name, "uploadMode": "regular", "shouldIgnore": False} for name in names]})
        elif "/commit/" in self.path:
            for line in map(json.loads, sent.splitlines()):
                if line["key"] == "file":
                    path = self.out / line["value"]["path"]
                    path.parent.mkdir(parents=True, exist_ok=True)
                    path.write_bytes(base64.b64decode(line["value"]["content"]))
            self._answer({"commitUrl": f"{REPOSITORY}/commit/0", "commitOid": "0" * 40})
        else:  # whether the header of README.md is valid, for one
            self._answer({})

    def _answer(self, content: dict[str, Any]) -> None:
        data = json.dumps(content).encode()
        self.send_response_only(200)  # without a line in the log
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)


def rehearse(folder: Path, kind: str, out: Path) -> int:
    """Uploads a folder to `out`, which must not be there, and returns how many files have arrived."""
    out.mkdir(parents=True)
    server = ThreadingHTTPServer(("127.0.0.1", 0), type("Here", (StandIn,), {"out": out}))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    address = f"http://127.0.0.1:{server.server_port}"
    here = {"HF_ENDPOINT": address, "HF_TOKEN": "none", "HF_HUB_OFFLINE": "0", "NO_PROXY": "127.0.0.1"}
    command = [Path(sys.executable).with_name("hf"), "upload", REPOSITORY, folder, ".", "--repo-type", kind]
    subprocess.run(command, env=os.environ | here, check=True)
    server.shutdown()
    names = [str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()]
    _, different, missing = filecmp.cmpfiles(folder, out, names, shallow=False)
    if different or missing:
        sys.exit(f"{out} lacks {', '.join([*different, *missing])}")
    return len(names)


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--type", choices=("dataset", "model"), default="dataset", help="of the repository")
    parser.add_argument("--out", type=Path, default=Path("out/hub"), help="a new folder, for what arrives")
    arguments = parser.parse_args()
    number = rehearse(arguments.folder, arguments.type, arguments.out)
    print(f"{number} files would be uploaded; they are in {arguments.out}")


if __name__ == "__main__":
    main()
