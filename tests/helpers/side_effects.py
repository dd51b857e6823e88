"""Calls the package as its users do, and prints what the calls have changed in the process.

Not compared: what third-party packages change when they are imported.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import locale
import logging
import os
import random
import signal
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd  # noqa: F401
import scipy.stats  # noqa: F401
import stable_baselines3  # noqa: F401
import torch
import torch._dynamo

import magical_mj


def snapshot() -> dict[str, Any]:
    """Everything that a library shares with its caller."""
    loggers = logging.root.manager.loggerDict.items()
    levels = {name: logger.level for name, logger in loggers if isinstance(logger, logging.Logger)}
    return {
        "Python's generator": random.getstate(),
        "numpy's generator": str(np.random.get_state()),  # noqa: NPY002
        "numpy's errors": np.geterr(),
        "numpy's printing": np.get_printoptions(),
        "torch's generator": torch.get_rng_state().tolist(),
        "torch's settings": (torch.get_num_threads(), torch.get_default_dtype(), torch.is_grad_enabled()),
        "torch's precision": (torch.get_float32_matmul_precision(), torch.are_deterministic_algorithms_enabled()),
        "warnings": list(warnings.filters),
        "signals": [signal.getsignal(number) for number in sorted(signal.valid_signals())],
        "logging": (logging.root.level, list(logging.root.handlers), {name: at for name, at in levels.items() if at}),
        "matplotlib": (dict(mpl.rcParams), mpl.get_backend(), plt.get_fignums()),
        "folder": Path.cwd(),
        "environment": dict(os.environ),
        "locale": locale.setlocale(locale.LC_ALL),
    }


def changes(call: Callable[[], Any]) -> dict[str, Any]:
    """What a call has changed, by name."""
    before = snapshot()
    with contextlib.redirect_stdout(io.StringIO()):
        call()
    return {name: value for name, value in snapshot().items() if value != before[name]}


def single() -> None:
    env = gymnasium.make("magical_mj/FindDupe-TestAll-LoRes4E-v0", render_mode="rgb_array", shifts="camera:3")
    env.reset(seed=0)
    env.step(3)
    env.render()
    env.close()


def vector() -> None:
    envs = magical_mj.make_vec("FindDupe", 2, renderer="software", shifts="texture:2")
    envs.reset(seed=0)
    envs.step([1, 2])
    envs.close()


def composed() -> None:
    env = magical_mj.load("FindDupe")
    env.reset(seed=0)
    env.step(1)
    env.close()


def sb3() -> None:
    from stable_baselines3 import PPO

    generators = torch.get_rng_state(), np.random.get_state(), random.getstate()  # noqa: NPY002
    model = PPO("MlpPolicy", gymnasium.make("magical_mj/MoveToRegion-Demo-State-v0"), n_steps=8, batch_size=8)
    model.save("model.zip")
    torch.set_rng_state(generators[0])
    np.random.set_state(generators[1])  # noqa: NPY002
    random.setstate(generators[2])
    evaluated("model.zip")


def untrained() -> None:
    """A folder with the policy of an untrained network."""
    from magical_mj.learners import load_settings
    from magical_mj.learners.networks import Actor
    from magical_mj.learners.policy import save_policy

    settings = load_settings("bc", "MoveToRegion", preset="State")
    generator = torch.get_rng_state()
    actor = Actor(settings.network, 1, states=True, batch_norm=False)
    torch.set_rng_state(generator)
    Path("run").mkdir()
    save_policy(Path("run"), actor, settings)


def evaluated(policy: Any, **settings: Any) -> None:
    magical_mj.evaluate(policy, tasks="MoveToRegion", variants="Demo", **{"episodes": 1, "jobs": 1, **settings})


def reported() -> None:
    from magical_mj.evaluation.reports.report import report
    from magical_mj.evaluation.reports.results import compare

    evaluated("noop", out="noop")
    report(["noop"], "report")
    compare("noop", "noop")


def demonstrated() -> None:
    env, *_ = magical_mj.datasets.make_env_and_datasets("magical_mj/FindDupe-Demo-State-v0")
    env.close()
    demo = magical_mj.demos.demonstrate("MoveToRegion", "Layout", 3)
    magical_mj.demos.keep(demo, "own")
    magical_mj.export_mjcf(magical_mj.Engine("FindDupe", seed=3), "model.xml")


def composer_imported() -> None:
    """dm_control's own imports change warnings and logging; its environment variables are ours."""
    with warnings.catch_warnings():
        level, handlers = logging.root.level, list(logging.root.handlers)
        importlib.import_module("magical_mj.envs.composer")
        logging.root.setLevel(level)
        logging.root.handlers[:] = handlers


CALLS: dict[str, Callable[[], Any]] = {
    "an environment": single,
    "a vector environment": vector,
    "importing composer": composer_imported,
    "composer": composed,
    "saving a policy": untrained,
    "a trained policy": lambda: evaluated("run"),
    "stable-baselines3": sb3,
    "an expert": lambda: evaluated("expert,random"),
    "reports": reported,
    "demonstrations": demonstrated,
}

if __name__ == "__main__":
    for name, call in CALLS.items():
        if changed := changes(call):
            sys.stdout.write(f"{name}: {', '.join(changed)}\n")
