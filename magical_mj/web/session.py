"""The session of one player at the server: answers the messages of one connection, with a simulation of its own.

Messages are JSON objects, each answered by one:

| message | answer |
|---|---|
| `{"open": {"task": ..., "variant": ..., "seed": ...}}` | `{"scene": ...}`, the scene of a new episode |
| `{"act": 0..17}` | `{"poses": {"robot": [x, y, angle], "fingers": [left, right], "blocks": [[x, y, angle], ...]}}` |
| `{"arrive": id or null}` | `{"participant": id, "next": {"task": ..., "variant": ..., "seed": ...} or null}` |
| `{"return": id}`, after a connection broke | `{"participant": id}` |
| `{"keep": recording}` | `{"score": ..., "next": ...}`, once the recording is a file |
| anything else, or a mistake | `{"error": "what is wrong"}` |

Arriving, returning and keeping need a collection; `magical_mj.demos` describes recordings.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Collection as Container
from typing import Any, Final

from magical_mj.engine import Engine
from magical_mj.scene import Scene
from magical_mj.tasks.registry import Pair
from magical_mj.utils.errors import MagicalError
from magical_mj.web.collection import Collection
from magical_mj.web.page_data import scene_data

LOGGER: Final = logging.getLogger(__name__)


class PlayerSession:
    """Answers the messages of one connection.

    Args:
        environments: the pairs (task, variant) that may be played.
        collection: where recordings are saved; None: nowhere.
    """

    def __init__(self, environments: Container[Pair], collection: Collection | None = None) -> None:
        self._environments = environments
        self._collection = collection
        self._participant: str | None = None
        self._env: Engine | None = None
        self._name: Pair | None = None

    def handle(self, text: str | bytes) -> str:
        """The answer to a message; errors are answered, never raised."""
        try:
            message = json.loads(text)
            if not isinstance(message, dict) or len(message) != 1:
                raise MagicalError("a message must be a JSON object with one key")
            ((kind, content),) = message.items()
            answers = {
                "open": self._open,
                "act": self._act,
                "arrive": self._arrive,
                "return": self._return,
                "keep": self._keep,
            }
            if kind not in answers:
                raise MagicalError(f"a message must be one of {', '.join(answers)}")
            reply = answers[kind](content)
        except OSError:  # which names files of the server
            LOGGER.exception("what a player sent cannot be saved")
            reply = {"error": "the server cannot save anything: please tell whoever runs it"}
        except (MagicalError, ValueError, RecursionError) as error:
            reply = {"error": str(error)}
        return json.dumps(reply, separators=(",", ":"))

    def close(self) -> None:
        """Free the simulation."""
        if self._env is not None:
            self._env.close()
            self._env = None

    def _open(self, content: Any) -> dict[str, Any]:
        match content:
            case {"task": str(task), "variant": str(variant), "seed": int(seed)}:
                pass
            case _:
                raise MagicalError("open needs a task, a variant and a seed")
        if (task, variant) not in self._environments:
            raise MagicalError(f"{task}-{variant} is not played here")
        if self._env is None or self._name != (task, variant):
            self.close()
            self._env, self._name = Engine(task, variant, seed=0), (task, variant)
        self._env.reset(seed=seed)
        return {"scene": scene_data(self._env.scene)}

    def _act(self, action: Any) -> dict[str, Any]:
        if self._env is None:
            raise MagicalError("open an environment before you act")
        self._env.step(action)
        return {"poses": poses(self._env.scene)}

    def _arrive(self, name: Any) -> dict[str, Any]:
        collection = self._collecting()
        self._participant = collection.participant(name)
        return {"participant": self._participant, "next": collection.next()}

    def _return(self, name: Any) -> dict[str, Any]:
        self._participant = self._collecting().participant(name)
        return {"participant": self._participant}

    def _keep(self, recording: Any) -> dict[str, Any]:
        collection = self._collecting()
        if self._participant is None:
            raise MagicalError("arrive before you send a recording")
        score = collection.keep(json.dumps(recording), self._participant)
        return {"score": score, "next": collection.next()}

    def _collecting(self) -> Collection:
        if self._collection is None:
            raise MagicalError("nothing is collected here")
        return self._collection


def poses(scene: Scene) -> dict[str, Any]:
    """Where everything is, as JSON data."""
    robot = scene.robot
    return {"robot": robot.pose, "fingers": robot.fingers, "blocks": [block.pose for block in scene.blocks]}
