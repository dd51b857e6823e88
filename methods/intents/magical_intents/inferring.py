"""Policies that infer an intent from demonstrations, plan a final scene for it, and reach it with the skill.

They have no simulator. Prior knowledge are the language of intents, the inference in `magical_goals`, and the plans of
intents, which are pure geometry. Learnt are the skill and, for pictures, the network that sees the scene.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from magical_goals.inference import Goal, best_intent, infer
from numpy.typing import NDArray
from torch import Tensor, nn

from magical_intents.carrier import NOTHING, Carrier
from magical_intents.scenes import ROBOT, scene_of
from magical_intents.sight import Sight
from magical_intents.skill import Skill
from magical_mj.intents import Intent
from magical_mj.intents.plans import plan
from magical_mj.learners import checkpoint
from magical_mj.learners.networks import COLOURS, SHAPES, blocks_of
from magical_mj.learners.settings import STATE
from magical_mj.observations import FINGERS
from magical_mj.policies.interface import Episode
from magical_mj.policies.models import torch_settings
from magical_mj.scene import Scene
from magical_mj.tasks.planning import Noise, scene_after
from magical_mj.utils import files
from magical_mj.utils.errors import TrainingError

POLICY: Final = "inferring.safetensors"
PICTURES: Final = "LoRes4A"
"""The preset of pictures. The newest of the four is used."""
ROBOT_ENTRIES: Final = FINGERS.stop
"""The number of the robot's entries in a state, which are the first ones."""
MISTAKEN: Final = 0.15
"""A block of another colour or shape counts as if it were this much farther (units)."""
LOST: Final = 0.4
"""A block that is seen farther (units) from where it was has the same colour and shape."""
PREFERRED: Final = 1.5
"""How often its first colour and shape count as seen."""


class InferringPolicy:
    """Infers the intent at the start of an episode, and brings one object after the other to its place.

    It plans again when no object is left.

    Attributes:
        preset: the preset of states, or of pictures if there is a network that sees.
    """

    uses_demonstrations = True

    def __init__(self, skill: Skill, sight: Sight | None) -> None:
        self._skill, self._sight = skill.eval(), sight and sight.eval()
        self.preset = STATE if sight is None else PICTURES
        self._inferred: dict[tuple[tuple[Scene, Scene], ...], list[Goal]] = {}

    def reset(self, episode: Episode) -> None:
        """Begins an episode."""
        ends = tuple(self._ends(np.asarray(demo.observations)) for demo in episode.demonstrations)
        if ends not in self._inferred:
            self._inferred[ends] = inferred(ends)
        self._goals, self._rng = self._inferred[ends], episode.rng()
        self._carrier: Carrier | None = None
        self._state: NDArray[np.float32] | None = None

    def __call__(self, observation: Any) -> int:
        """The action for an observation."""
        state = self._perceived(np.asarray(observation)[None], self._state)[0]
        if self._state is None:
            self._initial = scene_of(state)
            self._intent = best_intent(self._goals, self._initial)
        self._state = state
        if self._carrier is None or self._carrier.brought == NOTHING:
            places = places_after(self._intent, self._initial, scene_of(state))
            self._carrier = Carrier(self._skill, self._rng, places)
        return self._carrier(torch.tensor(state))

    def _ends(self, observations: NDArray[Any]) -> tuple[Scene, Scene]:
        """The first and the last scene of a demonstration."""
        states = self._perceived(observations, None)
        return scene_of(states[0]), scene_of(states[-1])

    def _perceived(self, observations: NDArray[Any], before: NDArray[np.float32] | None) -> NDArray[np.float32]:
        """The states (n, names) of successive observations, after a state if there is one."""
        if self._sight is None:
            return observations
        with torch_settings(1):
            seen = self._sight.states(observations[..., -3:])
        return followed(seen, before)


def followed(seen: NDArray[np.float32], before: NDArray[np.float32] | None) -> NDArray[np.float32]:
    """Successive states (n, names) with blocks and regions in the order of the first one, or of the state before.

    Each block becomes the nearest one that is seen, preferably of its colour and shape; without any, it stays. It has
    the colour and the shape that are seen most often.
    """
    states, last = [], seen[0] if before is None else before
    votes = PREFERRED * blocks_of(torch.tensor(last))[:, SHAPES.start :]
    for state in seen:
        now = last.copy()
        now[:ROBOT_ENTRIES] = state[:ROBOT_ENTRIES]
        old, new, places = (blocks_of(torch.from_numpy(one)) for one in (last, state, now))
        differ = (old[:, None, SHAPES.start :] != new[:, SHAPES.start :]).any(2)
        gaps = torch.cdist(old[:, 1:3], new[:, 1:3]) + MISTAKEN * differ
        gaps[differ & (gaps > LOST)] = math.inf
        gaps[(old[:, 0] == 0)[:, None] | (new[:, 0] == 0)] = math.inf
        while gaps.min() < math.inf:
            number, other = divmod(int(gaps.argmin()), len(gaps))
            places[number, 1:3] = new[other, 1:3]
            votes[number] += new[other, SHAPES.start :]
            gaps[number], gaps[:, other] = math.inf, math.inf
        states.append(now)
        last = now
    followed = np.stack(states)
    blocks = blocks_of(torch.from_numpy(followed))
    for columns in (SHAPES, COLOURS):
        kinds = votes[:, columns.start - SHAPES.start : columns.stop - SHAPES.start]
        blocks[..., columns] = nn.functional.one_hot(kinds.argmax(1), kinds.shape[1]) * blocks[..., :1]
    return followed


def inferred(ends: tuple[tuple[Scene, Scene], ...]) -> list[Goal]:
    """The intents of demonstrations, the most probable first; none if they show no goal."""
    try:
        return infer(ends)
    except TrainingError:
        return []


def places_after(intent: Intent | None, initial: Scene, now: Scene) -> Tensor:
    """The places of all objects after a plan for an intent, as `Carrier` wants them. A robot that stays has none."""
    places = torch.full((ROBOT + 1, 2), math.nan)
    todo = plan(intent, initial, now, Noise(np.random.default_rng(0), 0.0)) if intent else ()
    for number, block in enumerate(scene_after(now, todo).blocks):
        places[number] = torch.tensor(block.pose[:2])
    for subgoal in todo:
        if subgoal.block is None:
            places[ROBOT] = torch.tensor(subgoal.target)
    return places


@torch_settings()
def load_policy(folder: Path | str) -> InferringPolicy:
    """The policy in a training's folder.

    Raises:
        TrainingError: if the file is missing or damaged.
    """
    path = files.to_path(folder) / POLICY
    contents = checkpoint.read(path)
    try:
        skill, sight = Skill(), Sight() if "sight" in contents else None
        skill.load_state_dict(contents["skill"])
        if sight is not None:
            sight.load_state_dict(contents["sight"])
    except Exception as error:
        raise TrainingError(f"{path} does not contain a policy: {error}") from error
    return InferringPolicy(skill, sight)
