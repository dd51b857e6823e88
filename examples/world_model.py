"""Trains a world model on pictures with stable-worldmodel, and plans with it in MoveToRegion.

    .venv-stable-worldmodel/bin/python examples/world_model.py --out FOLDER    # after make integrations-test

Records random episodes in Layout, trains the library's LeWM with a small convolutional encoder on them, and plans to
the goal's picture by the cross-entropy method, in the scenes of seeds 0, 1, .... A second call with the same folder
plays with the trained model again. This is an example to start from, not yet a baseline: after 400 episodes and 600
batches, it solved 0 of 5 episodes in Demo. Random actions solve 1 in 20.

Variations name shifts or their factors, "scene" or "all". Factors of a scene can be set one by one, but are drawn only
together:

    options = {"variation": ["camera", "slip"], "variation_values": {"scene.robot": [0.3, 0.2, 1.0]}}
    world.reset(seed=5, options=options)
    print(world.infos["variation.camera"])

To continue episodes of a recording, pass these callables to
`world.evaluate(dataset=..., episodes_idx=..., start_steps=..., goal_offset=..., eval_budget=..., callables=callables)`:

    names = ("scene_seed", "steps", "simulation")
    callables = [{"method": "restore", "args": {name: {"value": name} for name in names}}]

stable-worldmodel 0.1.1 records each step after its action, so a recording lacks the first picture.
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

import numpy as np
import stable_worldmodel as swm  # pyright: ignore[reportMissingImports]
import torch
from stable_worldmodel.policy import BasePolicy, PlanConfig, WorldModelPolicy  # pyright: ignore[reportMissingImports]
from stable_worldmodel.solver import CEMSolver  # pyright: ignore[reportMissingImports]
from stable_worldmodel.wm.lewm import LeWM  # pyright: ignore[reportMissingImports]
from stable_worldmodel.wm.lewm.module import MLP, Embedder, Predictor  # pyright: ignore[reportMissingImports]
from stable_worldmodel.wm.loss import SIGReg  # pyright: ignore[reportMissingImports]
from torch import nn

import magical_mj
from magical_mj.experts import GoalPicture
from magical_mj.integrations.world_model import WorldEnv

BLOCK: Final = 5  # environment steps for each step of the model
FRAMES: Final = 4  # of a training sequence
WIDTH: Final = 64  # of embeddings
FIRST: Final = 1_000_000  # the seeds of the recording, outside the test split


class Encoder(nn.Module):
    """Pictures -> embeddings, with the interface of a Hugging Face vision transformer."""

    def __init__(self) -> None:
        super().__init__()
        channels, layers = (3, 16, 32, 64, 64), []
        for before, after in itertools.pairwise(channels):
            layers += [nn.Conv2d(before, after, 4, 2, 1), nn.GroupNorm(4, after), nn.SiLU()]
        self.layers = nn.Sequential(*layers, nn.Flatten(), nn.Linear(64 * 4 * 4, WIDTH))

    def forward(self, pixels: torch.Tensor, **_: Any) -> SimpleNamespace:
        """Pictures (n, 3, 64, 64) -> embeddings (n, 1, WIDTH)."""
        return SimpleNamespace(last_hidden_state=self.layers(pixels)[:, None])


def new_model() -> LeWM:
    """The library's model, with small sizes."""
    predictor = Predictor(
        num_frames=FRAMES - 1, depth=2, heads=4, dim_head=16, mlp_dim=128, input_dim=WIDTH, hidden_dim=WIDTH
    )
    project = [MLP(WIDTH, 128, WIDTH, norm_fn=nn.BatchNorm1d) for _ in range(2)]
    return LeWM(Encoder(), predictor, Embedder(3 * BLOCK, 32, WIDTH), *project)


class Sticky(BasePolicy):
    """Random actions. Each is repeated a random number of times."""

    def __init__(self, seed: int = 0) -> None:
        super().__init__()
        self.generator, self.actions = np.random.default_rng(seed), np.zeros(0)

    def get_action(self, obs: Any, **_: Any) -> np.ndarray:
        """An action for each environment."""
        drawn = self.generator.uniform(-1, 1, self.env.action_space.shape).astype(np.float32)
        drawn[:, 0] += 0.3  # more often forward
        change = self.generator.random(len(drawn)) < 0.25
        self.actions = np.where(change[:, None], drawn, self.actions) if self.actions.size else drawn
        return self.actions.clip(-1, 1)


def world(variant: str, count: int, *wrappers: Any) -> swm.World:
    """A world of MoveToRegion."""
    return swm.World(
        magical_mj.env_id("MoveToRegion", variant, "State"),
        count,
        image_shape=(64, 64),
        max_episode_steps=None,
        pre_wrappers=[*wrappers, WorldEnv],
        action="continuous",
        render_size=64,
    )


def record(path: Path, episodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Pictures (episodes, steps, 3, 64, 64) and the action after each, (episodes, steps, 3)."""
    if not path.exists():
        recorder = world("Layout", 8)
        recorder.set_policy(Sticky())
        recorder.collect(path, episodes=episodes, seed=FIRST)
        recorder.close()
    data = swm.data.LanceDataset(str(path))
    rows = [data.load_episode(number) for number in range(episodes)]
    return np.stack([row["pixels"] for row in rows]), np.stack([row["action"] for row in rows])


def train(model: LeWM, pictures: np.ndarray, actions: np.ndarray, batches: int) -> None:
    """Trains the model to predict the next embedding."""
    generator, regulariser = np.random.default_rng(0), SIGReg(num_proj=256)
    optimiser = torch.optim.AdamW(model.parameters(), 1e-3, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 1e-3, batches)
    latest = pictures.shape[1] - FRAMES * BLOCK
    for number in range(batches):
        rows = generator.integers(len(pictures), size=(64, 1))
        starts = generator.integers(latest, size=(64, 1))  # the last action of an episode is not known
        frames = pictures[rows, starts + BLOCK * np.arange(FRAMES)]
        taken = actions[rows, starts + np.arange(FRAMES * BLOCK)].reshape(64, FRAMES, -1)
        info = model.encode({"pixels": torch.from_numpy(frames).float() / 255, "action": torch.from_numpy(taken)})
        known, wanted = info["emb"], info["emb"][:, 1:]
        predicted = model.predict(known[:, :-1], info["act_emb"][:, :-1])
        error, spread = nn.functional.mse_loss(predicted, wanted), regulariser(known.transpose(0, 1))
        optimiser.zero_grad()
        (error + 0.1 * spread).backward()
        optimiser.step()
        schedule.step()
        if number % 100 == 0:
            print(f"batch {number}: error {error.item():.4f}, regulariser {spread.item():.3f}", flush=True)


def success(policy: BasePolicy, variant: str, episodes: int) -> float:
    """The share of episodes with score 1."""
    playing = world(variant, 5, GoalPicture)
    playing.set_policy(policy)
    rate = playing.evaluate(episodes=episodes, seed=0)["success_rate"] / 100
    playing.close()
    return rate


def main() -> None:
    """Records, trains and plays."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--record", type=int, default=400, help="episodes")
    parser.add_argument("--batches", type=int, default=3_000)
    parser.add_argument("--episodes", type=int, default=20, help="of each evaluation")
    options = parser.parse_args()
    torch.manual_seed(0)
    options.out.mkdir(parents=True, exist_ok=True)
    model, saved, times = new_model(), options.out / "model.pt", {}
    if saved.exists():
        model.load_state_dict(torch.load(saved, weights_only=True))
    else:
        start = time.process_time()
        pictures, actions = record(options.out / "episodes.lance", options.record)
        times["recording"] = time.process_time() - start
        train(model, pictures, actions, options.batches)
        times["training"] = time.process_time() - start - times["recording"]
        torch.save(model.state_dict(), saved)
    model.eval()
    solver = CEMSolver(model, num_samples=128, n_steps=6, topk=16)  # LeWM 0.1.1 plans for one environment at a time
    plan = PlanConfig(horizon=4, receding_horizon=1, action_block=BLOCK)
    scaled = {name: lambda picture: picture.as_subclass(torch.Tensor).float() / 255 for name in ("pixels", "goal")}
    policies = {"planned": WorldModelPolicy(solver, plan, transform=scaled), "random": Sticky(1)}
    rates = {}
    for name, policy in policies.items():
        start = time.process_time()
        for variant in ("Demo", "Jitter", "Layout"):
            rates[f"{name} {variant}"] = success(policy, variant, options.episodes)
        times[f"{name} episodes"] = time.process_time() - start
    result = {"success": rates, "CPU seconds": {name: round(seconds) for name, seconds in times.items()}}
    print(json.dumps(result, indent=1))
    (options.out / "result.json").write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
