"""LeRobot's checkpoints as policies of this package's evaluation."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np

from magical_mj.demos.export.lerobot import (
    FINGERS,
    IMAGE_SIZE,
    NO_STATE,
    PRESETS,
    STATE_VECTOR,
    VIEWS,
    image_keys,
    missing_lerobot,
    state,
)
from magical_mj.policies.interface import Episode
from magical_mj.policies.models import torch_threads
from magical_mj.scene.actions import to_discrete
from magical_mj.scene.state_vector import FINGERS as WHERE_FINGERS
from magical_mj.scene.state_vector import STATE_NAMES
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import SettingsError

try:
    import torch
    from lerobot.configs import PreTrainedConfig  # pyright: ignore[reportMissingImports]
    from lerobot.policies.factory import (  # pyright: ignore[reportMissingImports]
        get_policy_class,
        make_pre_post_processors,
    )
except ImportError:
    raise missing_lerobot() from None


class LeRobotPolicy:
    """A LeRobot checkpoint as `magical_mj.evaluate` plays policies; action chunks start anew with each episode.

    Attributes:
        preset: the preset whose newest frames, or whose vectors, the checkpoint sees.
    """

    def __init__(self, folder: Path) -> None:
        config = PreTrainedConfig.from_pretrained(folder)
        self._views, self._fingers = _observed(folder, config)
        config.device = "cpu"
        self._policy = get_policy_class(config.type).from_pretrained(folder, config=config).eval()
        self._before, self._after = make_pre_post_processors(
            config, str(folder), preprocessor_overrides={"device_processor": {"device": "cpu"}}
        )
        with_fingers = self._fingers and self._views != "state"
        self.preset = "LoResFingers" if with_fingers else PRESETS[self._views]
        self._sentence = ""
        self._noise = torch.Generator().get_state()

    def reset(self, episode: Episode) -> None:
        """Forgets the chunk of the last episode, and draws noise by the episode's seed."""
        self._noise = torch.Generator().manual_seed(int(episode.rng().integers(2**63))).get_state()
        self._policy.reset()
        self._sentence = task_spec(episode.task).summary

    def __call__(self, observation: Any) -> int:
        """The action for the newest frames of the preset, or for the state."""
        seen = observation if isinstance(observation, dict) else {self._views: observation}
        fingers = None
        if self._fingers:
            fingers = seen["fingers"] if "fingers" in seen else seen["state"][WHERE_FINGERS]
        batch: dict[str, Any] = {
            key: torch.from_numpy(np.ascontiguousarray(seen[view][..., -3:])).permute(2, 0, 1)[None].float() / 255
            for view, key in image_keys(self._views).items()
        } or {STATE_VECTOR: torch.from_numpy(seen["state"])[None]}
        batch["observation.state"] = torch.from_numpy(state(fingers))[None]
        # Policies draw from torch's own generator.
        with torch_threads(1), torch.inference_mode(), torch.random.fork_rng(devices=[]):
            torch.set_rng_state(self._noise)
            action = self._after(self._policy.select_action(self._before({**batch, "task": [self._sentence]})))
            self._noise = torch.get_rng_state()
        return to_discrete(action[0].numpy())


def load_checkpoint(folder: Path | str) -> LeRobotPolicy:
    """The policy in a LeRobot checkpoint's folder ``pretrained_model``; its weights are safetensors.

    Raises:
        SettingsError: if it was trained on other observations or actions than this package's.
    """
    return LeRobotPolicy(Path(folder))


def _observed(folder: Path, config: Any) -> tuple[str, bool]:
    """Which of `VIEWS` a checkpoint sees, and whether the angles of the fingers."""
    seen = {name: tuple(feature.shape) for name, feature in config.input_features.items()}
    actions = {name: tuple(feature.shape) for name, feature in config.output_features.items()}
    for views, fingers in itertools.product(VIEWS, (False, True)):
        if seen == _features(views, fingers) and actions == {"action": (3,)}:
            return views, fingers
    known = "\n".join(f"  {_features(views, fingers)}" for views in VIEWS for fingers in (False, True))
    raise SettingsError(
        f"the checkpoint {folder} makes {actions} of {seen}, and evaluations take {{'action': (3,)}} made of one of\n"
        f"{known}\nTrain it on a data set of magical-mj demos export --to lerobot."
    )


def _features(views: str, fingers: bool) -> dict[str, tuple[int, ...]]:
    """Name -> shape of what a checkpoint sees."""
    pictures = dict.fromkeys(image_keys(views).values(), (3, IMAGE_SIZE, IMAGE_SIZE))
    entries = len(FINGERS if fingers else NO_STATE)
    return {**(pictures or {STATE_VECTOR: (len(STATE_NAMES),)}), "observation.state": (entries,)}
