"""The server of the page: `magical-mj play --web`. Python simulates; the browser draws from poses.

All addresses start with a secret token, `http://127.0.0.1:8008/TOKEN/`; others are refused. The page communicates with
a `magical_mj.web.session.PlayerSession` through a WebSocket, which browsers may open only from a page of the server's
own origin.
"""

from __future__ import annotations

import asyncio
import ipaddress
import json
import mimetypes
import re
import secrets
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Final

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from magical_mj.tasks.registry import Pair
from magical_mj.web import PAGE
from magical_mj.web.collection import Collection
from magical_mj.web.page_data import catalogue, environment_scenes
from magical_mj.web.session import PlayerSession

LARGEST_MESSAGE: Final = 100_000  # bytes
LONGEST_LINE: Final = 8_000  # bytes of a request's first line
REQUEST: Final = re.compile(rb"([!-~]+) [!-~]+ HTTP/1\.[01]\r?")
METHODS: Final = ("GET", "HEAD", "OPTIONS")
HEADERS: Final = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",  # the address holds the token
    "X-Content-Type-Options": "nosniff",
}


@dataclass
class PlayServer:
    """Serves the page and its WebSocket connections.

    Args:
        environments: the pairs (task, variant) that may be played.
        host: the address at which to listen.
        port: 0 for any free port.
        token: the first part of the path; None: a random one.
        origin: the public origin of the page if it is not `http://HOST:PORT`, as behind a reverse proxy.
        collection: where recordings are saved; None: nowhere.
    """

    environments: Sequence[Pair]
    host: str = "127.0.0.1"
    port: int = 8008
    token: str = field(default_factory=lambda: secrets.token_urlsafe(16))
    origin: str | None = None
    collection: Collection | None = None

    def __post_init__(self) -> None:
        known = {**catalogue(self.environments, "server"), "collects": self.collection is not None}
        self._files = {path.name: path.read_bytes() for path in PAGE.iterdir() if path.is_file()}
        self._files["catalogue.json"] = json.dumps(known).encode()
        self._files[""] = self._files["index.html"]

    async def start(self) -> Server:
        """Listen; the server that is returned is an asynchronous context manager.

        Raises:
            OSError: if the port is taken.
        """
        server = await serve(
            self._play,
            self.host,
            self.port,
            process_request=self._respond,
            create_connection=_Connection,
            max_size=LARGEST_MESSAGE,
            server_header=None,
        )
        self.port = next(iter(server.sockets)).getsockname()[1]
        return server

    @property
    def address(self) -> str:
        """The page's address, once the server has started."""
        return f"{self._origins()[0]}/{self.token}/"

    def _origins(self) -> list[str]:
        """Those of the page, as browsers send them: IPv6 addresses in brackets, and no port that is the default."""
        host = "localhost" if self.host in ("0.0.0.0", "::") else self.host.lower()  # noqa: S104 (compared, not bound)
        with suppress(ValueError):  # it is a name
            host = str(ipaddress.ip_address(host))
        names = dict.fromkeys((f"[{host}]" if ":" in host else host, "localhost"))
        origins = [self.origin] if self.origin else [f"http://{name}:{self.port}" for name in names]
        return [origin.removesuffix(":443" if origin.startswith("https:") else ":80") for origin in origins]

    def _respond(self, _connection: ServerConnection, request: Request) -> Response | None:
        """The response with a file or a refusal; None if a WebSocket may be opened."""
        path = request.path.partition("?")[0]
        start, _, name = path.removeprefix("/").partition("/")
        if not self._is_addressed(request):
            advice = f"open {self._origins()[0]}, or start the server with --origin and the address that you use"
            return _response(HTTPStatus.MISDIRECTED_REQUEST, advice.encode())
        if not secrets.compare_digest(start.encode(), self.token.encode()) or path == f"/{self.token}":
            return _response(HTTPStatus.FORBIDDEN)
        if request.method == "OPTIONS":
            return _response(HTTPStatus.NO_CONTENT)
        if name == "socket":
            is_ours = request.method == "GET" and request.headers.get("Origin") in self._origins()
            return None if is_ours else _response(HTTPStatus.FORBIDDEN)
        content = self._content(name)
        status = HTTPStatus.NOT_FOUND if content is None else HTTPStatus.OK
        response = _response(status, content, mimetypes.guess_type(name or "index.html")[0])
        if request.method == "HEAD":
            response.body = b""
        return response

    def _is_addressed(self, request: Request) -> bool:
        """Whether the request is for this server; a site whose name leads here could read what its visitors play.

        Behind a proxy, which has another name for it, every request is.
        """
        hosts = request.headers.get_all("Host")
        return self.origin is not None or (len(hosts) == 1 and f"http://{hosts[0].lower()}" in self._origins())

    def _content(self, name: str) -> bytes | None:
        if name.startswith("scenes/"):
            task, _, variant = name.removeprefix("scenes/").removesuffix(".json").partition("-")
            if (task, variant) not in self.environments:
                return None
            return json.dumps(environment_scenes(task, variant), separators=(",", ":")).encode()
        return self._files.get(name)

    async def _play(self, connection: ServerConnection) -> None:
        """Serves one connection until it closes. Other connections are served while this one simulates."""
        session = PlayerSession(self.environments, self.collection)
        try:
            async for message in connection:
                await connection.send(await asyncio.to_thread(session.handle, message))
        except ConnectionClosed:  # closed abnormally, or after a message that was too large
            pass
        finally:
            session.close()


class _Connection(ServerConnection):
    """A connection that answers requests which websockets closes without a word: other methods, and what is no HTTP."""

    _beginning: bytes | None = b""
    """What has come of the request's first line; None once it is complete."""

    def data_received(self, data: bytes) -> None:
        """Called by asyncio with each part of what comes."""
        if self._beginning is not None:
            data = self._beginning + data
            line, end, _ = data.partition(b"\n")
            if not end and len(line) < LONGEST_LINE:
                self._beginning = data
                return
            self._beginning = None
            request = REQUEST.fullmatch(line)
            if request is None or request[1].decode() not in METHODS:
                refused = HTTPStatus.BAD_REQUEST if request is None else HTTPStatus.METHOD_NOT_ALLOWED
                self.transport.write(_response(refused).serialize())
                self.transport.close()
                return
        super().data_received(data)


def _response(status: HTTPStatus, body: bytes | None = None, kind: str | None = None) -> Response:
    content = b"" if status is HTTPStatus.NO_CONTENT else status.phrase.encode() if body is None else body
    headers = Headers(HEADERS)
    if status in (HTTPStatus.NO_CONTENT, HTTPStatus.METHOD_NOT_ALLOWED):
        headers["Allow"] = ", ".join(METHODS)
    if status is not HTTPStatus.NO_CONTENT:
        headers["Content-Type"] = f"{kind or 'text/plain'}; charset=utf-8"
        headers["Content-Length"] = str(len(content))
    headers["Connection"] = "close"
    return Response(status.value, status.phrase, headers, content)
