"""The server of the page of `magical-mj serve` and `collect`. Python simulates, and the browser draws poses.

All addresses start with a secret token, `http://127.0.0.1:8008/TOKEN/`. Others are rejected. The page talks to its own
`PlayerSession` through a WebSocket. Browsers may open it only from a page of the server's own origin. Each
message is a JSON object, and the answer is another one:

| message | answer |
|---|---|
| `{"open": {"task": name, "variant": name, "seed": 3}}` | `{"scene": ...}` of a new episode, and a puzzle's `"goal"` |
| `{"act": 0..17}` | `{"poses": {"robot": [x, y, angle], "fingers": [left, right], "blocks": [[x, y, angle], ...]}}` |
| `{"arrive": id or null}`, with `"agree": true` after consent | `{"participant": id, "next": ...}` |
| `{"return": id}`, after a connection broke | `{"participant": id}` |
| `{"keep": recording, "about": {"speed": ..., "watched": ...}}` | `{"score": ..., "next": ...}`, after saving |
| `{"answer": "A", "question": id, "seconds": 3.2}` | `{"answered": ids}`, those that the participant has answered |
| `{"answered": true}` | the same |
| other messages, and invalid ones | `{"error": "the reason"}` |

All but `open` and `act` need a study. `Collection.next` describes the values of `next`, and
`magical_mj.demos.recording` describes recordings. Under another secret token, the operator of a study sees its progress
(`operator.html`), with the messages `{"status": true}` and `{"pause": true or false}`, and downloads its demonstrations
(`demonstrations.zip`).
"""

from __future__ import annotations

import asyncio
import ipaddress
import json
import logging
import mimetypes
import secrets
from collections.abc import Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field
from http import HTTPStatus
from types import MappingProxyType
from typing import Any, ClassVar, Final

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from magical_mj.engine import Engine
from magical_mj.scene import Scene
from magical_mj.tasks.registry import Pair
from magical_mj.utils.errors import MagicalError
from magical_mj.web.asking import question_data
from magical_mj.web.collection import Collection
from magical_mj.web.page_data import PAGE, catalogue, environment_scenes, scene_data
from magical_mj.web.puzzles import VARIANTS, Puzzle, goal_data, puzzle_scenes

LOGGER: Final = logging.getLogger(__name__)
LARGEST_MESSAGE: Final = 100_000  # bytes
HEADERS: Final = {
    "Allow": "GET, HEAD",
    "Cache-Control": "no-store",
    "Connection": "close",
    "Referrer-Policy": "no-referrer",  # the address contains the token
    "X-Content-Type-Options": "nosniff",
}


@dataclass
class PlayServer:
    """Serves the page and its WebSocket connections.

    Args:
        environments: the pairs (task, variant) that may be played.
        host: the address of the server's network interface.
        port: 0 for any free port.
        token: the first part of the path; None: a random token.
        origin: the page's public origin if it is not `http://HOST:PORT`, for example behind a reverse proxy.
        collection: the study that saves recordings; None: they are not saved.
        puzzles: the intents that can be played as puzzles.
    """

    environments: Sequence[Pair]
    host: str = "127.0.0.1"
    port: int = 8008
    token: str = field(default_factory=lambda: secrets.token_urlsafe(16))
    origin: str | None = None
    collection: Collection | None = None
    puzzles: Sequence[Puzzle] = ()
    scripts: ClassVar[str] = "'self'"
    """The allowed sources of scripts, for browsers."""

    def __post_init__(self) -> None:
        self._puzzles = {puzzle.name: puzzle for puzzle in self.puzzles}
        self._operator = "" if self.collection is None else self.collection.token("operator")
        self._files = {path.name: path.read_bytes() for path in PAGE.iterdir() if path.is_file()}
        del self._files["intents.html"]  # it needs the simulation in the browser
        self._files["catalogue.json"] = json.dumps(self._catalogue()).encode()
        self._files[""] = self._files["index.html"]
        asked = {} if self.collection is None else self.collection.questions
        if asked:
            data = [question_data(question, answers=False) for question in asked.values()]
            self._files["questions.json"] = json.dumps(data, separators=(",", ":")).encode()
        else:
            del self._files["choose.html"]

    def _catalogue(self) -> dict[str, Any]:
        pairs = [pair for puzzle in self.puzzles for pair in puzzle.environments]
        known = {**catalogue(self.environments, "server", puzzles=pairs), "collects": self.collection is not None}
        if self.collection is not None:
            study = self.collection.study
            known |= {"shows": study.shows, "title": study.title, "instructions": study.instructions}
            known |= {"questions": study.questions}
        return known

    async def start(self) -> Server:
        """Starts the server. The returned server is an asynchronous context manager.

        Raises:
            OSError: if the port is in use.
        """
        server = await serve(
            self._play,
            self.host,
            self.port,
            process_request=self._respond,
            max_size=LARGEST_MESSAGE,
            server_header=None,
        )
        self.port = next(iter(server.sockets)).getsockname()[1]
        return server

    @property
    def address(self) -> str:
        """The page's address, after the server has started."""
        return f"{self._origins()[0]}/{self.token}/"

    @property
    def operators_address(self) -> str:
        """The address of the study operator's page, after the server has started."""
        return f"{self._origins()[0]}/{self._operator}/operator.html"

    def _origins(self) -> list[str]:
        """The page's origins in the form of browsers: IPv6 addresses in brackets, and no default port."""
        host = "localhost" if self.host in ("0.0.0.0", "::") else self.host.lower()  # noqa: S104 (compared, not bound)
        with suppress(ValueError):  # it is a host name
            host = str(ipaddress.ip_address(host))
        names = dict.fromkeys((f"[{host}]" if ":" in host else host, "localhost"))
        origins = [self.origin] if self.origin else [f"http://{name}:{self.port}" for name in names]
        return [origin.removesuffix(":443" if origin.startswith("https:") else ":80") for origin in origins]

    def _respond(self, _connection: ServerConnection, request: Request) -> Response | None:
        """The response with a file or an error. None if a WebSocket may be opened."""
        start, slash, name = request.path.partition("?")[0].removeprefix("/").partition("/")
        if not self._is_addressed(request):
            advice = f"open {self._origins()[0]}, or start the server with --origin and the address in use"
            return _response(HTTPStatus.MISDIRECTED_REQUEST, advice.encode())
        runs = bool(self._operator) and secrets.compare_digest(start.encode(), self._operator.encode())
        if not slash or not (runs or secrets.compare_digest(start.encode(), self.token.encode())):
            return _response(HTTPStatus.FORBIDDEN)
        if request.method not in ("GET", "HEAD"):
            return _response(HTTPStatus.METHOD_NOT_ALLOWED)
        if name == "socket":
            is_ours = request.method == "GET" and request.headers.get("Origin") in self._origins()
            return None if is_ours else _response(HTTPStatus.FORBIDDEN)
        if runs and self.collection is not None and name == "demonstrations.zip":
            content = self.collection.archive()
        else:
            content = None if not runs and name == "operator.html" else self._content(name)
        if content is None:
            return _response(HTTPStatus.NOT_FOUND)
        response = _response(HTTPStatus.OK, content, mimetypes.guess_type(name or "index.html")[0])
        response.headers["Content-Security-Policy"] = (
            f"default-src 'self'; script-src {self.scripts}; img-src 'self' data: blob:; frame-ancestors 'none'"
        )
        if request.method == "HEAD":
            response.body = b""
        return response

    def _is_addressed(self, request: Request) -> bool:
        """Whether the request names this server: a foreign site could let its own name resolve to this address.

        Behind a proxy with another name, every request is accepted.
        """
        hosts = request.headers.get_all("Host")
        return self.origin is not None or (len(hosts) == 1 and f"http://{hosts[0].lower()}" in self._origins())

    def _content(self, name: str) -> bytes | None:
        folder, _, file = name.partition("/")
        task, _, variant = file.removesuffix(".json").partition("-")
        if folder == "scenes" and (task, variant) in self.environments:
            data = environment_scenes(task, variant)
            if self.collection is not None and "expert" not in self.collection.study.shows:
                data |= {"demonstrations": [], "scenes": [{**scene, "expert": ""} for scene in data["scenes"]]}
        elif folder == "puzzles" and task in self._puzzles and variant in VARIANTS:
            data = puzzle_scenes(self._puzzles[task], variant)
        else:
            return self._files.get(name)
        return json.dumps(data, separators=(",", ":")).encode()

    async def _play(self, connection: ServerConnection) -> None:
        """Serves one connection until it closes. Other connections are served while this one simulates."""
        path = (connection.request or Request("", Headers())).path
        runs = bool(self._operator) and path.startswith(f"/{self._operator}/")
        with (
            suppress(ConnectionClosed),  # abnormally, or after too large a message
            closing(
                PlayerSession(
                    self.environments, self.collection, self._puzzles, runs=runs, address=self._network(connection)
                )
            ) as session,
        ):
            async for message in connection:
                await connection.send(await asyncio.to_thread(session.answer, message))

    def _network(self, connection: ServerConnection) -> str:
        """The address of the other side, of IPv6 the first half, which a household or an institute shares.

        Behind a proxy, it is the last one that the proxy names; "" if it names none.
        """
        address = str(connection.remote_address[0])
        if self.origin is not None:
            headers = connection.request.headers if connection.request else Headers()
            address = ",".join(headers.get_all("X-Forwarded-For")).rpartition(",")[2].strip()
        try:
            known = ipaddress.ip_address(address)
        except ValueError:
            return ""
        if isinstance(known, ipaddress.IPv6Address) and known.ipv4_mapped is None:
            return str(ipaddress.ip_network((int(known), 64), strict=False).network_address)
        return str(known)


def _response(status: HTTPStatus, body: bytes | None = None, kind: str | None = None) -> Response:
    content = status.phrase.encode() if body is None else body
    about = {"Content-Type": f"{kind or 'text/plain'}; charset=utf-8", "Content-Length": str(len(content))}
    return Response(status.value, status.phrase, Headers({**HEADERS, **about}), content)


class PlayerSession:
    """Answers the messages of one connection, with its own simulation.

    `runs` is whether it is the operator's, and `address` its network address, if known.
    """

    def __init__(
        self,
        environments: Sequence[Pair],
        collection: Collection | None = None,
        puzzles: Mapping[str, Puzzle] = MappingProxyType({}),
        *,
        runs: bool = False,
        address: str = "",
    ) -> None:
        self._environments = environments
        self._puzzles = puzzles
        self._runs, self._address = runs, address
        self._collection = collection
        self._participant: str | None = None
        self._engine: Engine | None = None

    def answer(self, text: str | bytes) -> str:
        """The answer to a message. Errors become answers and are not raised."""
        try:
            reply = self._reply(json.loads(text))
        except OSError:  # its text contains paths of the server
            LOGGER.exception("a player's recording cannot be saved")
            reply = {"error": "the server cannot save recordings: please inform its operator"}
        except (MagicalError, ValueError, OverflowError, RecursionError) as error:
            reply = {"error": str(error)}
        return json.dumps(reply, separators=(",", ":"))

    def close(self) -> None:
        """Frees the simulation."""
        if self._engine is not None:
            self._engine.close()
            self._engine = None

    def _reply(self, message: Any) -> dict[str, Any]:
        match message:
            case {"open": {"task": str(task), "variant": str(variant), "seed": int(seed)}}:
                return self._open(task, variant, seed)
            case {"act": action} if self._engine is not None:
                self._begin(self._engine)
                self._engine.step(action)
                return {"poses": poses(self._engine.scene)}
        reply = None if self._collection is None else self._collected(self._collection, message)
        if reply is None:
            raise MagicalError(
                "a message must be one of open, with a task, a variant and a seed; act, after open; and, if "
                "demonstrations are collected here, arrive or return, and after them keep, answer or answered"
            )
        return reply

    def _collected(self, collection: Collection, message: Any) -> dict[str, Any] | None:
        """The answer to a message about the collection. None if it is not one that the sender may send now."""
        me = self._participant
        match message:
            case {"arrive": name}:
                me = self._participant = self._identified(name, collection)
                if message.get("agree") is True:
                    collection.agree(me, self._address)
                return {"participant": me, **collection.next(me, self._address)}
            case {"return": name}:
                self._participant = self._identified(name, collection)
                return {"participant": self._participant}
            case {"keep": recording} if me is not None:
                about = message.get("about") if isinstance(message.get("about"), dict) else {}
                score = collection.keep(json.dumps(recording), me, about)
                return {"score": score, **collection.next(me, self._address)}
            case {"answer": str(letter), "question": str(question)} if me is not None:
                return collection.answer(me, question, letter, message.get("seconds"))
            case {"answered": True} if me is not None:
                return collection.answered(me)
            case {"status": True} if self._runs:
                return collection.status()
            case {"pause": bool(paused)} if self._runs:
                collection.pause(paused)
                return collection.status()
        return None

    def _identified(self, name: Any, collection: Collection) -> str:
        """The participant's id. A connection belongs to one participant: other ids cannot collect scenes over it."""
        if self._participant is not None and name not in (None, self._participant):
            raise MagicalError("this connection belongs to another participant: reload the page")
        return self._participant or collection.participant(name)

    def _begin(self, engine: Engine) -> None:
        """Reserves the scene at the first action in it."""
        if self._collection is not None and self._participant is not None and engine.steps == 0:
            self._collection.begin(self._participant, (engine.task, engine.variant, engine.seed))

    def _open(self, task: str, variant: str, seed: int) -> dict[str, Any]:
        puzzle = self._puzzles.get(task) if variant in VARIANTS else None
        if (task, variant) not in self._environments and puzzle is None:
            raise MagicalError(f"{task}-{variant} is not available here")
        if self._collection is not None and not self._collection.offered(self._participant, task, variant, seed):
            raise MagicalError("this scene was not offered to you")
        self.close()
        self._engine = Engine(puzzle.task if puzzle else task, variant, seed=seed)
        scene = self._engine.scene
        return {"scene": scene_data(scene), **({"goal": goal_data(puzzle.intent, scene)} if puzzle else {})}


def poses(scene: Scene) -> dict[str, Any]:
    """The poses of all objects, as JSON data."""
    robot = scene.robot
    return {"robot": robot.pose, "fingers": robot.fingers, "blocks": [block.pose for block in scene.blocks]}
