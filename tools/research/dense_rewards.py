"""SAC and PPO of Stable-Baselines3 from states, with dense rewards and with the score: the curves in docs/rewards.md.

    nice -n 19 python -m tools.research.dense_rewards --out FOLDER [--sac 8000] [--ppo 30000] [--variant Demo]
    python -m tools.research.dense_rewards --out FOLDER --plot    # docs/rewards.png

Plays MoveToRegion, MoveToCorner and FixColour in a variant, on one core; the curves are those of Demo. SAC acts by
vectors of speeds, PPO by the 18 actions. Both have two layers of 64 units and otherwise the library's settings, except
for those below. A stopped run is continued. FOLDER/LEARNER-TASK-VARIANT-REWARD/curve.csv holds the steps, the mean
score of the training episodes since the line before, and the seconds.
"""

from __future__ import annotations

import argparse
import itertools
import time
from pathlib import Path
from typing import Any, Final

import gymnasium
import numpy as np
import torch
from matplotlib.figure import Figure
from numpy.typing import NDArray
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

import magical_mj
from tools.pages import ROOT

TASKS: Final = ("MoveToRegion", "MoveToCorner", "FixColour")
REWARDS: Final = ("dense", "score")
POINTS: Final = 20
"""The number of lines of a curve."""
WORLDS: Final = 8  # of PPO
NETWORK: Final = {"net_arch": [64, 64]}
SAC_SETTINGS: Final[dict[str, Any]] = {
    "learning_rate": 1e-3,
    "learning_starts": 1_000,
    "batch_size": 128,
    "train_freq": 2,
    "ent_coef": "auto_0.1",
}
PPO_SETTINGS: Final[dict[str, Any]] = {"n_steps": 256, "batch_size": 256, "ent_coef": 0.01}


class Scores(BaseCallback):
    """Collects the scores of training episodes."""

    def __init__(self) -> None:
        super().__init__()
        self.scores: list[float] = []

    def _on_step(self) -> bool:
        ended = zip(self.locals["infos"], self.locals["dones"], strict=True)
        self.scores += [float(info["eval_score"]) for info, done in ended if done]
        return True


def train(learner: str, task: str, variant: str, reward: str, steps: int, folder: Path) -> None:
    """Trains one policy, or the rest of it, and adds a line to the curve after every part of the steps."""
    folder.mkdir(parents=True, exist_ok=True)
    curve, saved, buffer = (folder / name for name in ("curve.csv", "model.zip", "buffer.pkl"))
    kind, count, settings = (SAC, 1, SAC_SETTINGS) if learner == "sac" else (PPO, WORLDS, PPO_SETTINGS)
    action = "speeds" if learner == "sac" else "discrete"

    def make() -> gymnasium.Env[Any, Any]:
        return gymnasium.make(magical_mj.env_id(task, variant, "State"), reward=reward, action=action)

    worlds = make_vec_env(make, count, seed=0)
    if saved.exists():
        model = kind.load(saved, env=worlds)
        if isinstance(model, OffPolicyAlgorithm):
            model.load_replay_buffer(buffer)
    else:
        size: dict[str, Any] = {"buffer_size": steps} if learner == "sac" else {}
        model = kind("MlpPolicy", worlds, seed=0, policy_kwargs={**NETWORK}, device="cpu", **settings, **size)
        curve.write_text("steps,score,seconds\n")
    while model.num_timesteps < steps:
        scores, start = Scores(), time.process_time()
        model.learn(steps // POINTS, scores, reset_num_timesteps=False)
        seconds = time.process_time() - start
        model.save(saved)
        if isinstance(model, OffPolicyAlgorithm):
            model.save_replay_buffer(buffer)
        with curve.open("a") as file:
            file.write(f"{model.num_timesteps},{np.mean(scores.scores):.4f},{seconds:.1f}\n")
    buffer.unlink(missing_ok=True)
    worlds.close()


def curves(runs: Path) -> dict[tuple[str, str], dict[str, NDArray[np.float64]]]:
    """(learner, task) -> reward -> rows of steps and mean scores, of the steps that both rewards have reached."""
    found: dict[tuple[str, str], dict[str, NDArray[np.float64]]] = {}
    for learner, task in itertools.product(("ppo", "sac"), TASKS):
        paths = [runs / f"{learner}-{task}-Demo-{reward}" / "curve.csv" for reward in REWARDS]
        if all(path.exists() for path in paths):
            rows = [np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)[:, :2] for path in paths]
            least = min(map(len, rows))
            if least > 1:
                found[learner, task] = {reward: part[:least] for reward, part in zip(REWARDS, rows, strict=True)}
    return found


def plot(picture: Path, runs: Path) -> None:
    """Draws the mean scores over the steps, with a panel for each learner and task of which there are runs."""
    shown = curves(runs)
    figure = Figure((1.0 + 2.2 * len(shown), 2.6), layout="constrained", dpi=100)
    panels = figure.subplots(1, len(shown), sharey=True, squeeze=False)[0]
    for axes, ((learner, task), parts) in zip(panels, shown.items(), strict=True):
        for reward, rows in parts.items():
            axes.plot(rows[:, 0] / 1000, rows[:, 1], label=f'reward="{reward}"')
        axes.set(ylim=(-0.03, 1.03), xlabel="thousands of steps")
        axes.set_title(f"{learner.upper()}, {task}", fontsize=9)
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("mean score")
    panels[0].legend()
    figure.savefig(picture)


def main() -> None:
    """Trains all policies one after the other, or draws their curves."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--sac", type=int, default=8_000)
    parser.add_argument("--ppo", type=int, default=30_000)
    parser.add_argument("--tasks", default=",".join(TASKS))
    parser.add_argument("--variant", default="Demo")
    parser.add_argument("--plot", action="store_true")
    options = parser.parse_args()
    if options.plot:
        plot(ROOT / "docs" / "rewards.png", options.out)
        return
    torch.set_num_threads(1)
    for task in options.tasks.split(","):
        for learner in ("ppo", "sac"):
            steps = getattr(options, learner)
            for reward in REWARDS if steps else ():
                folder = options.out / f"{learner}-{task}-{options.variant}-{reward}"
                train(learner, task, options.variant, reward, steps, folder)


if __name__ == "__main__":
    main()
