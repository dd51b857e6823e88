"""`redraw`: cloning from images of scenes that are changed under `relational`'s assumptions.

Two policies are trained, as in Learning by Cheating (Chen et al. 2020, arXiv:1912.12294). The first is that of
`relational`. It learns from states, and the demo score decides which assumptions are kept. The second observes only
pictures. It learns the first policy's action probabilities (soft targets: Hinton, Vinyals and Dean 2015,
arXiv:1503.02531) in demonstrated states that are changed under the kept assumptions. Each state is drawn again, so that
the picture shows displaced blocks and changed colours. Two pictures in three show an unchanged demonstration,
with the demonstrator's action.

In addition to the requirements of `relational`, training needs the renderer. The second policy uses only pictures.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from magical_mj.assets.scene_model import SceneModel, Structure
from magical_mj.engine.simulation import Simulation
from magical_mj.envs.presets import PRESETS
from magical_mj.learners.bc import BehaviouralCloning
from magical_mj.learners.data import Batch
from magical_mj.learners.networks import COLOURS, ONE_HOT, SHAPE, SHAPES, blocks_of, regions_of
from magical_mj.learners.settings import STATE, TrainingSettings
from magical_mj.observations import FINGERS
from magical_mj.rendering.picture import Picture
from magical_mj.scene import Block, GoalRegion, Robot, Scene, constants
from magical_mj.utils.errors import SettingsError
from magical_relational.method import Relational
from magical_relational.settings import RelationalTrainingSettings

POOL: Final = 2048
"""The number of pictures in a pool."""
SHOWN: Final = 2 / 3
"""The share of pictures of unchanged demonstrations."""
BATCHES: Final = 128
"""The number of batches from each pool: with 64 samples in each, a picture is used four times."""
MISSING: Final = 50.0
"""Missing objects are put at this x and y (units), far outside the arena."""


class Redraw(BehaviouralCloning):
    """Minimises -E log pi(a | picture of s); a is an action of the policy of `relational`, or the demonstrator's."""

    parts: ClassVar[tuple[str, ...]] = ("network", "bc", "relational")
    settings_type: ClassVar[type[TrainingSettings]] = RelationalTrainingSettings
    defaults: ClassVar[Mapping[str, Any]] = {
        "network.frames": 1,
        "bc.batch_size": 64,
        "bc.optimizer": "adam",
        "bc.final_learning_rate": 1e-5,
        "bc.heads": "uniform",
    }

    def __init__(self, settings: RelationalTrainingSettings) -> None:
        self.check(settings)
        self._teacher = Relational(replace(settings, preset=STATE))
        super().__init__(settings)
        self._batches, self.updates = self.updates, self.updates + self._teacher.updates
        self._count = 0

    @classmethod
    def check(cls, settings: TrainingSettings) -> None:
        """Checks the requirements of a training, and raises the errors of its start."""
        if settings.states or len(settings.tasks) > 1 or len(PRESETS[settings.preset].frames) > 1:
            raise SettingsError("redraw learns one task from one view: give one task and the preset LoRes4E or LoRes4A")
        Relational.check(replace(settings, preset=STATE))

    def dataset(self, demonstrations: object) -> Pool:
        """The pictures for training."""
        del demonstrations
        return Pool(self._teacher, PRESETS[self.settings.preset].frames[0][0], self.settings.renderer)

    def update(self) -> Mapping[str, float]:
        """Trains the first policy until it is finished, and then the second."""
        if not self._teacher.finished:
            metrics = self._teacher.update()
            self.updates = self._teacher.updates + self._batches
            return metrics
        if self._count % BATCHES == 0:
            self.data.renew()
        self._count += 1
        return super().update()

    def loss(self) -> tuple[Tensor, Tensor, Tensor, Mapping[str, float]]:
        """As in cloning, but the actions (n,) are the most probable ones."""
        loss, logits, probabilities, others = super().loss()
        return loss, logits, probabilities.argmax(1), others

    def recalibrate(self) -> None:
        """The same as in cloning, after the second policy's training has begun."""
        if self._count:
            super().recalibrate()

    def save_policy(self, folder: Path) -> None:
        """Writes the second policy, and the first one's report on assumptions."""
        super().save_policy(folder)
        self._teacher.write_report(folder)

    def get_state(self) -> dict[str, Any]:
        """The states of both policies, and the generator's state at the start of the current pool."""
        own = {"count": self._count, "begun": self.data.begun, "teacher": self._teacher.get_state()}
        return super().get_state() | own

    def set_state(self, state: dict[str, Any]) -> None:
        """Restores a state from `get_state`, and draws the pool again."""
        super().set_state(state)
        self._teacher.set_state(state["teacher"])
        self.updates = self._teacher.updates + self._batches
        self._count = state["count"]
        if self._count:
            self._teacher.draw.set_state(state["begun"])
            self.data.renew()


class Pool:
    """Pictures of samples under the teacher's assumptions, and the teacher's action probabilities.

    Attributes:
        begun: the state of the teacher's generator before the current pictures were drawn.
    """

    def __init__(self, teacher: Relational, view: str, renderer: str | None) -> None:
        self._teacher, self._redrawer = teacher, Redrawer(view, renderer)
        self._pictures = torch.empty((POOL, *SHAPE[:2], 3), dtype=torch.uint8)
        self._probabilities = torch.zeros(POOL, ONE_HOT)
        self.begun = teacher.draw.get_state()

    def renew(self) -> None:
        """Draws new samples."""
        self.begun = self._teacher.draw.get_state()
        shown, demonstrated = self._teacher.samples(round(SHOWN * POOL), changed=False)
        states, _ = self._teacher.samples(POOL - len(shown))
        with torch.inference_mode():
            logits = self._teacher.actor.logits(states)
        certain = nn.functional.one_hot(demonstrated.cpu(), ONE_HOT).float()
        self._probabilities = torch.cat([certain, logits.softmax(1).cpu()])
        self._redrawer.draw(torch.cat([shown, states]).cpu(), self._pictures.numpy())

    def sample(self, size: int, generator: torch.Generator) -> Batch:
        """Random samples of the current pictures, with one frame each. The actions are probabilities (n, 18)."""
        rows = torch.randint(POOL, (size,), generator=generator)
        return Batch(self._pictures[rows], self._probabilities[rows], torch.zeros(size, dtype=torch.int64))


class Redrawer:
    """Draws states in the view "ego" or "allo". Any states can be drawn, not only simulated ones."""

    def __init__(self, view: str, renderer: str | None) -> None:
        self._view, self._renderer = view, renderer
        self._simulations: dict[Structure, Simulation] = {}

    def draw(self, states: Tensor, out: Picture) -> None:
        """Draws states (n, names) into pictures (n, size, size, 3)."""
        for scene, picture in zip(scenes_of(states), out, strict=True):
            simulation = self._simulations.get(structure := SceneModel(scene).structure)
            if simulation is None:
                simulation = self._simulations[structure] = Simulation.of(scene, renderer=self._renderer)
            else:
                simulation.start(scene)
            simulation.draw(self._view, len(picture), picture)


def scenes_of(states: Tensor) -> list[Scene]:
    """The scenes of states (n, names), at rest. Objects that are missing in a state are out of sight.

    Blocks are sorted by shape, so that few models are sufficient for all samples.
    """
    numbers = zip(states.numpy(), blocks_of(states).numpy(), regions_of(states).numpy(), strict=True)
    return [Scene(_robot(state), _blocks(blocks), _regions(regions)) for state, blocks, regions in numbers]


def _robot(state: NDArray[np.float32]) -> Robot:
    (x, y, angle), (left, right) = state[:3].tolist(), state[FINGERS].tolist()
    return Robot(x, y, angle, (left, right))


def _blocks(rows: NDArray[np.float32]) -> tuple[Block, ...]:
    blocks = []
    for number, row in enumerate(rows[rows[:, SHAPES].any(1)]):
        x, y, angle = row[1:4].tolist() if row[0] else (MISSING + number, MISSING, 0.0)
        shape, colour = constants.SHAPES[row[SHAPES].argmax()], constants.COLOURS[row[COLOURS].argmax()]
        blocks.append(Block(shape, colour, x, y, angle))
    return tuple(sorted(blocks, key=lambda block: block.shape))


def _regions(rows: NDArray[np.float32]) -> tuple[GoalRegion, ...]:
    regions = []
    for row in rows[rows[:, 5:].any(1)]:
        x_min, y_min, x_max, y_max = (row[1:5] + (0.0 if row[0] else MISSING)).tolist()
        regions.append(GoalRegion(constants.COLOURS[row[5:].argmax()], x_min, y_min, x_max, y_max))
    return tuple(regions)
