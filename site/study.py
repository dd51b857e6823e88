"""Simulates a study with 30 participants of five kinds, and kills its server three times: python site/study.py.

Quotas must be met exactly, no episode may count twice, and every confirmed episode must be on the disk.
"""

from __future__ import annotations

import asyncio
import json
import random
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any, Final

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import InvalidHandshake, WebSocketException
from websockets.typing import Origin

from magical_mj import demos
from magical_mj.actions import ACTIONS
from magical_mj.protocol import PROTOCOL
from magical_mj.web.collection import LOG

KINDS: Final = ("honest", "random", "duplicating", "reloading", "two tabs")
PEOPLE: Final = 30
QUOTAS: Final = {"MoveToRegion-Demo": 12, "MoveToRegion-Layout": 12, "MoveToRegion-All": 11}
HORIZON: Final = 40
KILLS: Final = 3


class Person:
    """A participant who plays until the study is complete, and reconnects after lost connections."""

    def __init__(self, study: Simulation, number: int) -> None:
        self.study, self.kind, self.rng = study, KINDS[number % len(KINDS)], random.Random(number)  # noqa: S311
        self.name: str | None = None
        self.confirmed: list[list[int]] = []
        self.refusals: Counter[str] = Counter()

    async def play(self) -> None:
        """Plays until the study is complete."""
        while not await self._visit():
            await asyncio.sleep(0.3)

    async def _visit(self) -> bool:
        """Plays over one connection. Returns whether the study is complete."""
        try:
            async with connect(self.study.socket, origin=Origin(self.study.origin)) as seat:
                reply = await self._ask(seat, {"arrive": self.name, "agree": True})
                self.name = reply["participant"]
                while reply.get("next"):
                    reply = await self._episode(seat, reply["next"])
                    if self.kind == "reloading":
                        return False
                return "everything" in reply.get("why", "")
        except (OSError, WebSocketException, InvalidHandshake):
            return False

    async def _episode(self, seat: ClientConnection, offer: dict[str, Any]) -> dict[str, Any]:
        scene = {key: offer[key] for key in ("task", "variant", "seed")}
        recording = await self._recorded(seat, scene)
        if self.kind == "two tabs":
            async with connect(self.study.socket, origin=Origin(self.study.origin)) as other:
                same = await self._ask(other, {"arrive": self.name})
                if same.get("next"):
                    if {key: same["next"][key] for key in scene} != scene:
                        raise SystemExit(f"a second tab got {same['next']} instead of {scene}")
                    await self._send(other, await self._recorded(other, scene))
        reply = await self._send(seat, recording)
        if self.kind == "duplicating":
            await self._send(seat, recording)
            async with connect(self.study.socket, origin=Origin(self.study.origin)) as other:
                await self._ask(other, {"arrive": None, "agree": True})
                await self._send(other, recording, own=False)
        if "error" in reply:
            return await self._ask(seat, {"arrive": self.name})
        return reply

    async def _recorded(self, seat: ClientConnection, scene: dict[str, Any]) -> dict[str, Any]:
        actions = [self.rng.randrange(len(ACTIONS)) for _ in range(HORIZON)]
        if self.kind == "honest":
            actions = [self.rng.choice((1, 4, 7)) for _ in range(HORIZON)]
        await self._ask(seat, {"open": scene})
        final: dict[str, Any] = {}
        for action in actions:
            final = (await self._ask(seat, {"act": action})).get("poses", {})
        return {"format": 1, "protocol": PROTOCOL, **scene, "actions": actions, "final": final}

    async def _send(self, seat: ClientConnection, recording: dict[str, Any], *, own: bool = True) -> dict[str, Any]:
        reply = await self._ask(seat, {"keep": recording, "about": {"speed": 1, "watched": False}})
        if "error" in reply:
            self.refusals[reply["error"]] += 1
        elif own and recording["actions"] not in self.confirmed:
            self.confirmed.append(recording["actions"])
        return reply

    async def _ask(self, seat: ClientConnection, message: dict[str, Any]) -> dict[str, Any]:
        await seat.send(json.dumps(message))
        return json.loads(await asyncio.wait_for(seat.recv(), 60))


class Simulation:
    """All participants, and the server, which is killed and restarted at the same address."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.port = folder / "collected", 0
        study = folder / "study.toml"
        lines = [f"{name} = {wanted}" for name, wanted in QUOTAS.items()]
        study.write_text(
            "\n".join(['consent = "Your actions are stored."', "lease_minutes = 1", "[environments]", *lines])
        )
        self.command = [sys.executable, "-m", "magical_mj", "collect", str(self.folder)]
        self.command += ["--study", str(study)]

    def start(self) -> None:
        """Starts the server."""
        command = [*self.command, "--port", str(self.port)]
        self.server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        address = next(iter(self.server.stdout or []), "").strip()
        self.origin, self.socket = address.rsplit("/", 2)[0], f"{address.replace('http', 'ws', 1)}socket"
        self.port = int(self.origin.rpartition(":")[2])

    def stop(self) -> None:
        """Kills the server."""
        self.server.kill()
        self.server.communicate()

    async def run(self) -> list[Person]:
        """Runs the whole study. Returns the participants."""
        people = [Person(self, number) for number in range(PEOPLE)]
        tasks = [asyncio.create_task(person.play()) for person in people]
        total = sum(QUOTAS.values())
        for kill in range(1, KILLS + 1):
            while self.saved() < kill * total // (KILLS + 1):
                await asyncio.sleep(0.05)
            await asyncio.to_thread(self.stop)
            await asyncio.to_thread(self.start)
        await asyncio.gather(*tasks)
        return people

    def saved(self) -> int:
        """The number of demonstrations on the disk."""
        return len(demos.files_in(self.folder))


def main(folder: Path) -> None:
    """Runs the study, and raises a SystemExit if one of the conditions is violated."""
    study = Simulation(folder)
    study.start()
    try:
        people = asyncio.run(study.run())
    finally:
        study.stop()
    kept = [demos.read(path) for path in demos.files_in(study.folder)]
    counts = Counter(demo.name for demo in kept)
    if counts != QUOTAS:
        log = (study.folder / LOG).read_text(encoding="utf-8")
        raise SystemExit(f"{log}\nthe quotas {QUOTAS} were not met exactly: {dict(counts)}. The study's log is above")
    if len({(demo.name, demo.actions.tobytes()) for demo in kept}) != len(kept):
        raise SystemExit("an episode counts twice")
    on_disk = {tuple(demo.actions.tolist()) for demo in kept}
    lost = [actions for person in people for actions in person.confirmed if tuple(actions) not in on_disk]
    if lost:
        raise SystemExit(f"{len(lost)} confirmed episodes are lost")
    refused = sum((person.refusals for person in people), Counter[str]())
    print(f"{PEOPLE} participants, {KILLS} kills: {dict(counts)}, all distinct, none lost")
    print(f"refused: {dict(refused)}")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        main(Path(temporary))
