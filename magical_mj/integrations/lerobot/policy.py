"""LeRobot's checkpoints as policies of this package's evaluation."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from magical_mj.actions import to_discrete
from magical_mj.demos.lerobot import NO_STATE, VIEWS, image_keys, missing_lerobot, state
from magical_mj.episodes import Episode
from magical_mj.errors import SettingsError
from magical_mj.registry import task_spec

try:
    import torch
    from lerobot.configs import PreTrainedConfig  # pyright: ignore[reportMissingImports]
    from lerobot.policies.factory import (  # pyright: ignore[reportMissingImports]
        get_policy_class,
        make_pre_post_processors,
    )
except ImportError:
    raise missing_lerobot() from None

_PRESETS: Final = {"ego": "LoRes4E", "allo": "LoRes4A", "both": "LoResStack"}
"""The preset whose newest frames are the views that a checkpoint sees."""


class LeRobotPolicy:
    """A LeRobot checkpoint as `magical_mj.evaluate` plays policies; action chunks start anew with each episode.

    Attributes:
        preset: the preset whose newest frames the checkpoint sees.
    """

    def __init__(self, folder: Path) -> None:
        torch.set_num_threads(1)  # sums depend on how they are split, and workers must not fight for cores
        config = PreTrainedConfig.from_pretrained(folder)
        self._views = _views_of(folder, config.input_features)
        config.device = "cpu"
        self._policy = get_policy_class(config.type).from_pretrained(folder, config=config).eval()
        self._before, self._after = make_pre_post_processors(
            config, str(folder), preprocessor_overrides={"device_processor": {"device": "cpu"}}
        )
        self.preset = _PRESETS[self._views]
        self._sentence = ""

    def reset(self, episode: Episode) -> None:
        """Forgets the chunk of the last episode, and draws noise by the episode's seed."""
        torch.manual_seed(int(episode.rng().integers(2**63)))
        self._policy.reset()
        self._sentence = task_spec(episode.task).summary

    def __call__(self, observation: Any) -> int:
        """The action for the newest frames of the preset."""
        frames = observation if isinstance(observation, dict) else {self._views: observation}
        keys = image_keys(self._views)
        batch: dict[str, Any] = {
            key: torch.from_numpy(np.ascontiguousarray(frames[view][..., -3:])).permute(2, 0, 1)[None].float() / 255
            for view, key in keys.items()
        }
        batch["observation.state"] = torch.from_numpy(state(None))[None]
        with torch.inference_mode():
            action = self._after(self._policy.select_action(self._before({**batch, "task": [self._sentence]})))
        return to_discrete(action[0].numpy())


def load_checkpoint(folder: Path | str) -> LeRobotPolicy:
    """The policy in a LeRobot checkpoint's folder ``pretrained_model``; its weights are safetensors.

    Raises:
        SettingsError: if it was trained on other observations or actions than this package's.
    """
    return LeRobotPolicy(Path(folder))


def _views_of(folder: Path, features: Mapping[str, Any]) -> str:
    """Which of `VIEWS` a checkpoint sees."""
    for views in VIEWS:
        seen = {*image_keys(views).values(), "observation.state"}
        if features.keys() == seen and features["observation.state"].shape == (len(NO_STATE),):
            return views
    known = " or ".join(" and ".join(image_keys(views).values()) for views in VIEWS)
    raise SettingsError(
        f"the checkpoint {folder} looks at {', '.join(features)}; evaluations have {known}, without the fingers' angles"
    )
