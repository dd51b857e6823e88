"""What a task is, as data: the type that every task module fills in and that variants read."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from magical_mj import constants as c
from magical_mj.scene import Scene

Rules = Literal["paper", "released"]
RULES: tuple[Rules, ...] = get_args(Rules)

ScoreFunction = Callable[[Scene, Scene, Rules], float]
"""Initial scene, final scene, rules -> score in [0, 1]."""

AxisRule = Callable[[np.random.Generator, Scene], Scene]
"""Draws one attribute of a scene anew (colours, shapes or counts); poses are placed afterwards."""
