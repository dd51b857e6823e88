"""How long seats at the server of `play --web` wait for their poses: python site/seats.py [SEATS] [SECONDS]."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from websockets.asyncio.client import connect
from websockets.typing import Origin

import magical_mj
from magical_mj.scene.constants import CONTROL_RATE


async def sit(address: str, number: int, until: float) -> list[float]:
    """Play at 8 Hz until then; the seconds from each action to its answer."""
    task, variant = magical_mj.ENVIRONMENTS[-1 - number % len(magical_mj.ENVIRONMENTS)]
    rng, waits = np.random.default_rng(number), []
    async with connect(f"{address.replace('http', 'ws', 1)}socket", origin=Origin(address.rsplit("/", 2)[0])) as seat:
        await seat.send(json.dumps({"open": {"task": task, "variant": variant, "seed": number}}))
        await seat.recv()
        await asyncio.sleep(rng.uniform(0, 1 / CONTROL_RATE))
        due = time.perf_counter()
        while due < until:
            await asyncio.sleep(max(0.0, due - time.perf_counter()))
            sent = time.perf_counter()
            await seat.send(json.dumps({"act": int(rng.integers(18))}))
            await seat.recv()
            waits.append(time.perf_counter() - sent)
            due += 1 / CONTROL_RATE
    return waits


async def main(address: str, seats: int, seconds: float) -> list[float]:
    """All waits of all seats."""
    until = time.perf_counter() + seconds
    return [wait for waits in await asyncio.gather(*(sit(address, n, until) for n in range(seats))) for wait in waits]


if __name__ == "__main__":
    seats, seconds = (int(argument) for argument in [*sys.argv[1:], "10", "60"][:2])
    command = [sys.executable, "-m", "magical_mj", "play", "--web", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            address = next(iter(server.stdout or []), "").strip()
            waits = asyncio.run(main(address, seats, seconds))
            user, system = (float(time) for time in Path(f"/proc/{server.pid}/stat").read_text().split()[13:15])
        finally:
            server.kill()
    median, late, latest = np.percentile(waits, [50, 99, 100]) * 1000
    print(f"{seats} seats, {seconds} s, {len(waits)} actions, {(user + system) / 100 / seconds:.1%} of a core")
    print(f"answered after {median:.1f} ms (median), {late:.1f} ms (p99), {latest:.1f} ms (the longest)")
