"""Rehearses an upload to the Hugging Face Hub: runs its command `hf upload` against a local test server.

    python tools/hub.py FOLDER [--type dataset] [--out out/hub]

It needs huggingface_hub, but no account and no network. The test server writes the files to a folder. It answers like
the hub for files that are small enough for git. All files must arrive unchanged.
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


class LocalHub(BaseHTTPRequestHandler):
    """Answers the requests of an upload, and writes the files of its commits to the folder `out`."""

    out: Path

    def do_GET(self) -> None:
        """Answers as for an empty repository."""
        self._answer({})

    def do_POST(self) -> None:
        """Answers the creation of the repository, requests for upload modes, and the commit."""
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
        else:  # such as the validation of README.md's header
            self._answer({})

    def _answer(self, content: dict[str, Any]) -> None:
        data = json.dumps(content).encode()
        self.send_response_only(200)  # without a line in the log
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)


def rehearse(folder: Path, kind: str, out: Path) -> int:
    """Uploads a folder to `out`, which must not exist. Returns the number of files that have arrived."""
    out.mkdir(parents=True)
    server = ThreadingHTTPServer(("127.0.0.1", 0), type("Here", (LocalHub,), {"out": out}))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    address = f"http://127.0.0.1:{server.server_port}"
    here = {"HF_ENDPOINT": address, "HF_TOKEN": "none", "HF_HUB_OFFLINE": "0", "NO_PROXY": "127.0.0.1"}
    command = [Path(sys.executable).with_name("hf"), "upload", REPOSITORY, folder, ".", "--repo-type", kind]
    subprocess.run(command, env=os.environ | here, check=True)
    server.shutdown()
    names = [str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()]
    _, different, missing = filecmp.cmpfiles(folder, out, names, shallow=False)
    if different or missing:
        sys.exit(f"missing or different in {out}: {', '.join([*different, *missing])}")
    return len(names)


def main() -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--type", choices=("dataset", "model"), default="dataset", help="the repository's type")
    parser.add_argument("--out", type=Path, default=Path("out/hub"), help="a new folder for the uploaded files")
    arguments = parser.parse_args()
    number = rehearse(arguments.folder, arguments.type, arguments.out)
    print(f"{number} files would be uploaded; they are in {arguments.out}")


if __name__ == "__main__":
    main()
