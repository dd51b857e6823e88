"""SAC of Stable-Baselines3 on x-magical's SweepToTop from states: the curves in docs/bodies-transfer.md.

    python -m tools.research.sac_xmagical --body longstick --reward sparse --out FOLDER/longstick-sparse [--steps 75000]
    python -m tools.research.sac_xmagical --plot docs/bodies-sac.png --out FOLDER    draws the curves of its runs

The settings are XIRL's (Zakka et al. 2021): three stacked states, 5,000 random steps, a discount of 0.99, learning
rates of 1e-4, a learnt temperature from 0.1, and an evaluation of 50 episodes with the mean action every 5,000 steps.
Its networks of 2 x 1024 with batches of 1024 would take a day on one core, so the defaults are networks of 2 x 256 and
batches of 256 (`--width`, `--batch`). A stopped run is continued. FOLDER/curve.csv holds steps, mean score and mean
return.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import gymnasium
import numpy as np
import torch
from gymnasium.wrappers import FlattenObservation, FrameStackObservation
from matplotlib.figure import Figure
from stable_baselines3 import SAC
from stable_baselines3.common.monitor import Monitor

import magical_mj  # noqa: F401 - registers the ids

EVERY, EPISODES, RANDOM_STEPS, STACK = 5_000, 50, 5_000, 3
FIRST_TEST_SEED = 10_042
"""The first seed of evaluations. As in XIRL, it differs from the seeds of training."""


def make(body: str, reward: str) -> gymnasium.Env[np.ndarray, np.ndarray]:
    """The environment of training and evaluation, with stacked states."""
    id_ = f"magical_mj/SweepToTop-{body.capitalize()}-State-Allo-TestLayout-v0"
    return FlattenObservation(FrameStackObservation(gymnasium.make(id_, reward=reward), STACK))


def evaluate(model: SAC, body: str, reward: str) -> tuple[float, float]:
    """The mean score and the mean return of the policy's mean action."""
    scores, returns = [], []
    env = make(body, reward)
    for episode in range(EPISODES):
        observation, _ = env.reset(seed=FIRST_TEST_SEED + episode)
        total, over, info = 0.0, False, {}
        while not over:
            observation, gain, _, over, info = env.step(model.predict(observation, deterministic=True)[0])
            total += float(gain)
        scores.append(info["eval_score"])
        returns.append(total)
    env.close()
    return float(np.mean(scores)), float(np.mean(returns))


def plot(picture: Path, runs: Path) -> None:
    """Draws the mean scores of all runs in a folder over their steps."""
    figure = Figure((8.0, 3.0), layout="constrained", dpi=100)
    axes = figure.subplots()
    for path in sorted(runs.glob("*/curve.csv")):
        steps, scores, _ = np.loadtxt(path, delimiter=",", skiprows=1).T
        axes.plot(steps, scores, label=path.parent.name.replace("-", ", "))
    axes.set(xlabel="step", ylabel="mean score", ylim=(0, 1))
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right upper")
    figure.savefig(picture)


def main() -> None:
    """Trains a policy, and writes a line of the curve after every evaluation. With --plot, draws the curves instead."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--body", default="longstick")
    parser.add_argument("--reward", default="sparse")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=75_000)
    parser.add_argument("--width", type=int, default=256)
    parser.add_argument("--batch", type=int, default=256)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--plot", type=Path)
    options = parser.parse_args()
    if options.plot:
        plot(options.plot, options.out)
        return
    torch.set_num_threads(1)
    options.out.mkdir(parents=True, exist_ok=True)
    curve, saved, buffer = (options.out / name for name in ("curve.csv", "model.zip", "buffer.pkl"))
    env = Monitor(make(options.body, options.reward))
    if saved.exists():
        model = SAC.load(saved, env=env)
        model.load_replay_buffer(buffer)
    else:
        model = SAC(
            "MlpPolicy",
            env,
            learning_rate=1e-4,
            buffer_size=max(options.steps, RANDOM_STEPS),
            learning_starts=RANDOM_STEPS,
            batch_size=options.batch,
            tau=0.005,
            gamma=0.99,
            ent_coef="auto_0.1",
            target_update_interval=2,
            policy_kwargs={"net_arch": [options.width, options.width]},
            seed=options.seed,
        )
        curve.write_text("steps,score,return\n")
    while model.num_timesteps < options.steps:
        model.learn(EVERY, reset_num_timesteps=False)
        score, total = evaluate(model, options.body, options.reward)
        model.save(saved)
        model.save_replay_buffer(buffer)
        with curve.open("a") as file:
            file.write(f"{model.num_timesteps},{score:.4f},{total:.3f}\n")


if __name__ == "__main__":
    main()
