"""Behavioural cloning on many intents from images, with the sentence: one network from images and words to actions.

python -m magical_intents.pictures OUT

It writes OUT/pictures, the folder of a policy. It takes a few minutes of one core. The network
does not learn to wait: of several successive steps without driving and turning, only the first is used.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from magical_intents.network import SIZE, Sentences
from magical_intents.policy import drawn_actions
from magical_intents.symmetries import words_of
from magical_intents.train import LARGEST, LEARNING_RATE, demonstrated, trained_intents, words_for
from magical_mj.actions import ACTIONS, Drive, Turn
from magical_mj.intents import Intent
from magical_mj.learners import checkpoint
from magical_mj.learners.learner import seeded
from magical_mj.learners.networks import ONE_HOT, maxima
from magical_mj.policies.interface import Episode
from magical_mj.policies.models import Model, torch_settings
from magical_mj.utils import files
from magical_mj.utils.errors import TrainingError

PRESET: Final = "LoRes3EA"
"""The current picture of the arena, and the last three of the robot's view."""
POLICY: Final = "pictures.safetensors"
INTENTS: Final = 200
UPDATES: Final = 1500
BATCH: Final = 128
_RESTS: Final = np.array([(a.turn, a.drive) == (Turn.NONE, Drive.NONE) for a in ACTIONS])


class Film(NamedTuple):
    """An intent's demonstration: small pictures (steps, 48, 48, 12), actions (steps,), and sentences' words."""

    pictures: NDArray[np.uint8]
    actions: NDArray[np.int64]
    words: NDArray[np.int64]


class Sighted(nn.Module):
    """Logits of the 18 actions for pictures and words."""

    def __init__(self) -> None:
        super().__init__()
        self.context = Sentences()
        self.see = nn.Sequential(
            nn.Conv2d(12, 32, 5, 2, 2), nn.ReLU(), nn.Conv2d(32, 64, 3, 2, 1), nn.ReLU(),
            nn.Conv2d(64, 64, 3, 2, 1), nn.ReLU(), nn.Flatten(),
        )  # fmt: skip
        self.act = nn.Sequential(
            nn.Linear(64 * 36 + SIZE, 256), nn.ReLU(), nn.Linear(256, 256), nn.ReLU(), nn.Linear(256, ONE_HOT)
        )

    def forward(self, pictures: Tensor, words: Tensor) -> Tensor:
        """Logits (n, 18) of small pictures (n, 48, 48, 12) from 0 to 255 and words (n, LENGTH)."""
        seen = self.see(pictures.permute(0, 3, 1, 2).float() / 255)
        return self.act(torch.cat([seen, maxima(*self.context(words))], 1))


def small(pictures: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Pictures (n, 96, 96, 12) at half the size."""
    n, height, width, channels = pictures.shape
    parts = pictures.reshape(n, height // 2, 2, width // 2, 2, channels)
    return parts.mean((2, 4), dtype=np.float32).astype(np.uint8)


def films(intents: Iterable[Intent], folder: Path | None = None) -> list[Film]:
    """A demonstration of each intent in each of the variants. The demonstrations are kept in `folder`."""
    found = []
    for intent, examples in demonstrated(intents, PRESET, folder):
        for example in examples:
            rests = _RESTS[example.actions]
            acts = ~(rests & np.concatenate([[False], rests[:-1]]))
            pictures = small(np.asarray(example.observations)[acts])
            found.append(Film(pictures, example.actions[acts].astype(int), words_for(intent)))
    return found


def train(
    data: Sequence[Film], out: Path, updates: int = UPDATES, watch: Callable[[int, float], object] = lambda _, __: None
) -> None:
    """Minimises -E log pi(a | pictures, sentence), and writes the policy into `out`."""
    with seeded(0):
        network = Sighted()
    optimizer = torch.optim.Adam(network.parameters(), LEARNING_RATE)
    rate = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.01, updates)
    rng, losses = np.random.default_rng(0), list[float]()
    for update in range(updates):
        chosen = [data[number] for number in rng.integers(len(data), size=BATCH)]
        steps = [rng.integers(len(film.actions)) for film in chosen]
        pairs = list(zip(chosen, steps, strict=True))
        pictures = torch.from_numpy(np.stack([film.pictures[step] for film, step in pairs]))
        words = torch.from_numpy(np.stack([film.words[rng.integers(len(film.words))] for film in chosen]))
        right = torch.tensor([film.actions[step] for film, step in pairs])
        loss = nn.functional.cross_entropy(network(pictures, words), right)
        optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), LARGEST)
        optimizer.step()
        rate.step()
        losses.append(loss.item())
        if (update + 1) % 100 == 0:
            watch(update + 1, float(np.mean(losses[-100:])))
    out.mkdir(parents=True, exist_ok=True)
    checkpoint.write(out / POLICY, {"weights": network.state_dict()})


class SightedPolicy(Model):
    """Draws actions from the network's probabilities with the episode's generator."""

    uses_instruction = True
    preset = PRESET

    def __init__(self, network: Sighted) -> None:
        super().__init__(self._drawn)
        self._network = network.eval()

    def reset_batch(self, episodes: Sequence[Episode]) -> None:
        """Begins episodes that are played together."""
        super().reset_batch(episodes)
        self._words = torch.from_numpy(np.stack([words_of(episode.instruction) for episode in episodes]))
        self._rngs = [episode.rng() for episode in episodes]

    def _drawn(self, pictures: NDArray[Any]) -> NDArray[np.int64]:
        with torch_settings(1), torch.inference_mode():
            logits = self._network(torch.from_numpy(small(pictures)), self._words[: len(pictures)])
        return drawn_actions(logits, self._rngs)


@torch_settings()
def load_policy(folder: Path | str) -> SightedPolicy:
    """The policy in a training's folder.

    Raises:
        TrainingError: if the file is missing or damaged.
    """
    path = files.to_path(folder) / POLICY
    contents = checkpoint.read(path)
    try:
        network = Sighted()
        network.load_state_dict(contents["weights"])
    except Exception as error:
        raise TrainingError(f"{path} does not contain a policy: {error}") from error
    return SightedPolicy(network)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--folder", type=Path, help="folder of the demonstrations; by default in the user's cache")
    chosen = parser.parse_args()
    with torch_settings(1):
        train(
            films(trained_intents(INTENTS), chosen.folder),
            chosen.out / "pictures",
            watch=lambda updates, loss: sys.stdout.write(f"{updates} {loss:.4f}\n"),
        )
