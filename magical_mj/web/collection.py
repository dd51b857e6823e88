"""Collecting demonstrations from many people: each recording is replayed and saved in the participant's folder."""

from __future__ import annotations

import itertools
import re
import secrets
import threading
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from magical_mj import demos
from magical_mj.demos.demonstration import SUFFIX
from magical_mj.tasks.registry import Pair
from magical_mj.utils import files
from magical_mj.utils.errors import DemonstrationError, SettingsError

_PARTICIPANT: Final = re.compile("[0-9a-f]{16}")
_TOKEN: Final = re.compile("[A-Za-z0-9_-]{16,}")


class Collection:
    """A folder with a subfolder for each participant, named by a random id, with their demonstrations.

    Args:
        folder: the folder; it is made if missing, and existing demonstrations count.
        environments: the pairs (task, variant) of which demonstrations are wanted.
        wanted: the number wanted of each; None: unlimited.

    Raises:
        OSError: if the folder cannot be made.
        DemonstrationError: if a demonstration in it is damaged.
    """

    def __init__(self, folder: Path, environments: Sequence[Pair], wanted: int | None = None) -> None:
        self._folder = folder
        self._environments = environments
        self._wanted = wanted
        self._lock = threading.Lock()
        folder.mkdir(parents=True, exist_ok=True)
        self._kept = {
            (task, variant): [
                demos.read(path, task).scene_seed for path in folder.glob(f"*/{task}-{variant}-*{SUFFIX}")
            ]
            for task, variant in environments
        }
        self._offered = Counter({pair: len(seeds) for pair, seeds in self._kept.items()})
        self._seeds = {pair: itertools.count() for pair in environments}

    def token(self) -> str:
        """The secret part of the page's address, which stays the same when the server is restarted.

        Raises:
            OSError: if it cannot be saved.
            SettingsError: if the file in which it is saved holds something else.
        """
        path = self._folder / "token"
        with suppress(FileExistsError):  # from an earlier time, or another process
            files.write(path, secrets.token_urlsafe(16), mode=0o600)
        token = path.read_text(encoding="ascii", errors="replace").strip()
        if not _TOKEN.fullmatch(token):
            raise SettingsError(f"{path} must hold the secret part of the address; delete it, and a new one is made")
        return token

    def participant(self, name: Any) -> str:
        """The id `name` if it has the form of one, as of a participant who returns, else a new id."""
        return name if isinstance(name, str) and _PARTICIPANT.fullmatch(name) else secrets.token_hex(8)

    def next(self) -> dict[str, Any] | None:
        """The next episode to play: the wanted environment that was offered least often, and a seed that was not kept.

        None if there are enough demonstrations of all.
        """
        with self._lock:
            unfinished = [
                pair for pair in self._environments if self._wanted is None or len(self._kept[pair]) < self._wanted
            ]
            if not unfinished:
                return None
            task, variant = chosen = min(unfinished, key=lambda pair: self._offered[pair])
            self._offered[chosen] += 1
            seed = next(seed for seed in self._seeds[chosen] if seed not in self._kept[chosen])
            return {"task": task, "variant": variant, "seed": seed}

    def keep(self, recording: str, participant: str) -> float:
        """Replays a recording and saves it as a demonstration before it returns; the same one counts once.

        Returns:
            Its score.

        Raises:
            MagicalError: if it is not a recording of these environments, or does not end as the player saw it.
        """
        demo, deviation, suspect = demos.from_recording(recording)
        pair = demo.task, demo.variant
        if pair not in self._environments:
            raise DemonstrationError(f"demonstrations of {demo.name} are not collected here")
        if suspect:
            raise DemonstrationError(f"the replay ends {deviation:.3g} away from what was played: reload the page")
        with self._lock:
            _, is_new = demos.keep(demo, self._folder / participant)
            if is_new:
                self._kept[pair].append(demo.scene_seed)
        return demo.score
