"""Trains policies for many intents: a skill, sight, and a scorer that receives a sentence, or demonstrations.

python -m magical_intents.train OUT

It writes the networks into OUT/skill, OUT/sight and OUT/scorer, and the folders of policies: OUT/sentence and
OUT/demonstrations with the scorer, and OUT/inference and OUT/pictures, which infer the intent. A second call with the
same folder continues the training.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor, nn

from magical_intents import inferring
from magical_intents.lessons import kept_lessons, scorer_loss
from magical_intents.policy import DEMONSTRATIONS, POLICY, SENTENCE
from magical_intents.practice import practised
from magical_intents.scenery import views
from magical_intents.scorer import Scorer
from magical_intents.sight import Sight, sight_loss
from magical_intents.skill import Skill, skill_loss
from magical_mj.intents import SETS
from magical_mj.learners import checkpoint
from magical_mj.learners.learner import seeded
from magical_mj.policies.models import torch_settings
from magical_mj.utils.errors import TrainingError

NOVICE, SKILL, SIGHT, SCORER = "novice", "skill", "sight", "scorer"
"""The trainings. The novice is a skill that acts in a part of the practice of the final one."""
UPDATES: Final = {NOVICE: 4000, SKILL: 4000, SIGHT: 2200, SCORER: 5000}
PRACTICE: Final = {NOVICE: 17, SKILL: 6}
"""The number of files of practice that each adds."""
VIEWS: Final = 12
"""The number of files of pictures."""
LEARNING_RATE: Final = {NOVICE: 1e-3, SKILL: 1e-3, SIGHT: 2.5e-3, SCORER: 1.5e-3}
LARGEST: Final = 1.0
"""The largest norm of a gradient."""
SAVED: Final = 100
"""The number of updates between two writes of the network."""


def train(
    data: Sequence[Any],
    out: Path,
    kind: str,
    *,
    updates: int | None = None,
    saved: int = SAVED,
    seed: int = 0,
    watch: Callable[[int, float], object] = lambda _, __: None,
) -> None:
    """Trains a skill with `Steps`, sight with `View`s, or the scorer with `Lesson`s, and writes it into `out`.

    After each writing of the network, `watch` is called with the number of updates and the mean loss.

    Raises:
        TrainingError: if the folder holds another training.
    """
    updates = updates or UPDATES[kind]
    path, training = out / POLICY, {"kind": kind, "updates": updates, "samples": len(data), "seed": seed}
    with seeded(seed):
        network: Any = {SCORER: Scorer, SIGHT: Sight}.get(kind, Skill)()
    optimizer = torch.optim.Adam(network.parameters(), LEARNING_RATE[kind])
    rate = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.01, updates)
    done, losses = 0, []
    if path.exists():
        state = checkpoint.read(path)
        if state["training"] != training:
            raise TrainingError(f"{path} is of another training, {state['training']}: give another folder")
        done = state["updates"]
        network.load_state_dict(state["weights"])
        optimizer.load_state_dict(state["optimizer"])
        rate.load_state_dict(state["rate"])
    out.mkdir(parents=True, exist_ok=True)
    loss_of: Callable[..., Tensor] = {SCORER: scorer_loss, SIGHT: sight_loss}.get(kind, skill_loss)
    for update in range(done, updates):
        loss = loss_of(network, data, np.random.default_rng([seed, update]))
        optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), LARGEST)
        optimizer.step()
        rate.step()
        losses.append(loss.item())
        if (update + 1) % saved == 0 or update + 1 == updates:
            kept = {"weights": network.state_dict(), "optimizer": optimizer.state_dict(), "rate": rate.state_dict()}
            checkpoint.write(path, {"training": training, "updates": update + 1, **kept})
            watch(update + 1, float(np.mean(losses)))
            losses.clear()


def skilled(out: Path, seed: int = 0) -> None:
    """Trains the skill, with the practice in a folder. The novice acts first in the last part of the practice."""
    steps = practised(out / "practice", PRACTICE[NOVICE])
    train(steps, out / NOVICE, NOVICE, seed=seed, watch=_print)
    novice = Skill()
    novice.load_state_dict(checkpoint.read(out / NOVICE / POLICY)["weights"])
    steps += practised(out / "recovery", PRACTICE[SKILL], novice.eval())
    train(steps, out / SKILL, SKILL, seed=seed, watch=_print)


def write_policies(out: Path) -> None:
    """Writes the folders of the policies, with the networks in `out`."""
    skill, sight, scorer = (checkpoint.read(out / kind / POLICY)["weights"] for kind in (SKILL, SIGHT, SCORER))
    for name, contents in {"inference": {}, "pictures": {"sight": sight}}.items():
        (out / name).mkdir(exist_ok=True)
        checkpoint.write(out / name / inferring.POLICY, {"skill": skill, **contents})
    for given in (SENTENCE, DEMONSTRATIONS):
        (out / given).mkdir(exist_ok=True)
        checkpoint.write(out / given / POLICY, {"given": given, "skill": skill, "scorer": scorer})


def _print(updates: int, loss: float) -> None:
    sys.stdout.write(f"{updates} {loss:.4f}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=0, help="of the networks and the batches")
    chosen = parser.parse_args()
    with torch_settings(1):
        skilled(chosen.out, chosen.seed)
        train(views(chosen.out / "views", VIEWS), chosen.out / SIGHT, SIGHT, seed=chosen.seed, watch=_print)
        train(kept_lessons(SETS["train"], chosen.out), chosen.out / SCORER, SCORER, seed=chosen.seed, watch=_print)
        write_policies(chosen.out)
