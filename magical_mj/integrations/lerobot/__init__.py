"""The environments in LeRobot's commands, and LeRobot's checkpoints in this package's evaluation.

LeRobot's commands find this module by ``--env.discover_packages_path=magical_mj.integrations.lerobot``; the options
``--env.type=magical --env.task=FindDupe --env.variant=Layout`` then choose environments (comma lists make one suite
for each task). Observations are ``pixels`` (96 px pictures, height x width x channels, uint8; a dict of views with
``--env.views=both``), or with ``--env.views=state`` ``environment_state``; and ``agent_pos``: three zeros, or with
``--env.fingers=true`` the angles of the two fingers. Actions are vectors (drive, turn, grip), and the
score is the reward of the last step. ``--env.shifts=camera:3,latency:1`` shifts them (docs/shifts.md; the sentence that
policies get is that of the episode), and ``--env.body=shortstick`` gives the robot another body (docs/bodies.md).
``--seed=0 --eval.n_episodes=100`` plays the scenes of seeds 0 to 99.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final, cast

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

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
from magical_mj.envs.gymnasium_env import MagicalEnv
from magical_mj.envs.presets import STATE_BOUND
from magical_mj.policies.interface import Episode
from magical_mj.policies.models import torch_settings
from magical_mj.scene import constants as c
from magical_mj.scene.actions import to_discrete
from magical_mj.scene.bodies import GRIPPER
from magical_mj.scene.state_vector import FINGERS as WHERE_FINGERS
from magical_mj.scene.state_vector import STATE_NAMES
from magical_mj.shifts.registry import Shifts
from magical_mj.tasks.registry import environments, task_spec
from magical_mj.utils.errors import SettingsError, check_name

try:
    import torch
    from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig  # pyright: ignore[reportMissingImports]
    from lerobot.envs.configs import EnvConfig  # pyright: ignore[reportMissingImports]
    from lerobot.policies.factory import (  # pyright: ignore[reportMissingImports]
        get_policy_class,
        make_pre_post_processors,
    )
except ImportError:
    raise missing_lerobot() from None

__all__ = ["LeRobotEnv", "LeRobotPolicy", "MagicalConfig", "load_checkpoint"]


class LeRobotEnv(gymnasium.ObservationWrapper[dict[str, Any], NDArray[np.float32], NDArray[np.float32]]):
    """One environment with the names and shapes that LeRobot reads.

    Args:
        task: a task's name.
        variant: a variant's name.
        views: "ego", "allo" or "both"; with "state", ``environment_state`` is the state vector, without pictures.
        fingers: whether ``agent_pos`` holds the angles of the fingers (rad), shape (2,), or zeros, shape (3,).
        shifts: shifts and their strengths, such as "camera:3,latency:1"; see docs/shifts.md.
        body: the robot's body, one that the task offers; see docs/bodies.md.

    Raises:
        UnknownNameError: if there is no such task, variant, choice of views or shift.
        SettingsError, InvalidSceneError: if the task cannot have the shifts or the body.
    """

    def __init__(
        self,
        task: str,
        variant: str,
        views: str = "ego",
        *,
        fingers: bool = False,
        shifts: Shifts = None,
        body: str = GRIPPER,
    ) -> None:
        check_name("choice of views", views, VIEWS)
        world: dict[str, Any] = {"shifts": shifts, "body": body}
        env = MagicalEnv(task, variant, "State", reward="score", action="continuous", render_mode="rgb_array", **world)
        super().__init__(cast("gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]", env))
        self._engine, self._views, self._with_fingers = env.engine, VIEWS[views], fingers
        self.task = task
        self._max_episode_steps = self._engine.horizon
        parts: dict[str, spaces.Space[Any]] = {"environment_state": env.observation_space}
        if self._views:
            picture = spaces.Box(0, 255, (IMAGE_SIZE, IMAGE_SIZE, 3), np.uint8)
            several = spaces.Dict(dict.fromkeys(self._views, picture))
            parts = {"pixels": picture if len(self._views) == 1 else several}
        state_shape = (len(FINGERS if fingers else NO_STATE),)
        self.observation_space = spaces.Dict(
            {**parts, "agent_pos": spaces.Box(-STATE_BOUND, STATE_BOUND, state_shape, np.float32)}
        )

    @property
    def task_description(self) -> str:
        """The sentence that says what is to be done in this episode, as its shifts make it."""
        return self._engine.instruction

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Starts an episode; of the options only "scene" is ours, LeRobot passes others of its own."""
        ours = {name: value for name, value in (options or {}).items() if name == "scene"}
        return super().reset(seed=seed, options=ours)

    def observation(self, observation: NDArray[np.float32]) -> dict[str, Any]:
        """The pictures of the present state, or its vector, and the fingers from the vector."""
        parts: dict[str, Any] = {"environment_state": observation}
        if self._views:
            pictures = {view: self._engine.render(view, IMAGE_SIZE) for view in self._views}
            parts = {"pixels": pictures if len(pictures) > 1 else pictures[self._views[0]]}
        return {**parts, "agent_pos": state(observation[WHERE_FINGERS] if self._with_fingers else None)}


@EnvConfig.register_subclass("magical")
@dataclass
class MagicalConfig(EnvConfig):
    """``--env.type=magical``: which environments, and what is observed."""

    task: str | None = "MoveToRegion"
    variant: str = "Demo"
    views: str = "ego"
    fingers: bool = False
    shifts: str = ""
    body: str = GRIPPER
    fps: int = c.CONTROL_RATE
    features: dict[str, Any] = field(default_factory=dict)
    features_map: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        picture = PolicyFeature(type=FeatureType.VISUAL, shape=(IMAGE_SIZE, IMAGE_SIZE, 3))
        keys = image_keys(self.views)
        names = {"pixels" if len(keys) == 1 else f"pixels/{view}": key for view, key in keys.items()}
        self.features = {
            "action": PolicyFeature(type=FeatureType.ACTION, shape=(3,)),
            "agent_pos": PolicyFeature(type=FeatureType.STATE, shape=(len(FINGERS if self.fingers else NO_STATE),)),
            **dict.fromkeys(names, picture),
        }
        if not names:
            names = {"environment_state": STATE_VECTOR}
            self.features["environment_state"] = PolicyFeature(type=FeatureType.ENV, shape=(len(STATE_NAMES),))
        self.features_map = {"action": "action", "agent_pos": "observation.state", **names}

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Of no use: `create_envs` makes the environments."""
        return {}

    def create_envs(
        self, n_envs: int, use_async_envs: bool = False
    ) -> dict[str, dict[int, gymnasium.vector.VectorEnv[Any, Any, Any]]]:
        """Suite (the task) -> number of the variant -> vector of environments."""
        mode = gymnasium.vector.AutoresetMode.SAME_STEP
        suites: dict[str, dict[int, gymnasium.vector.VectorEnv[Any, Any, Any]]] = {}
        for task, variant in environments(self.task or "all", self.variant):
            how: dict[str, Any] = {"fingers": self.fingers, "shifts": self.shifts, "body": self.body}
            make = [partial(LeRobotEnv, task, variant, self.views, **how)] * n_envs
            suite = suites.setdefault(task, {})
            if use_async_envs and n_envs > 1:  # spawned: OpenGL does not survive a fork
                vector: Any = gymnasium.vector.AsyncVectorEnv(make, context="spawn", autoreset_mode=mode)
            else:
                vector = gymnasium.vector.SyncVectorEnv(make, autoreset_mode=mode)
            suite[len(suite)] = vector
        return suites


WITHOUT_LANGUAGE: Final = ("act", "diffusion", "gaussian_actor", "tdmpc", "vqbet")
"""The kinds of lerobot's policies that do not read the task's sentence, though each gets it."""


class LeRobotPolicy:
    """A LeRobot checkpoint as `magical_mj.evaluate` plays policies; action chunks start anew with each episode.

    Attributes:
        uses_instruction: whether it reads the sentence that says what is to be done.
        preset: the preset whose newest frames, or whose vectors, the checkpoint sees.
    """

    def __init__(self, folder: Path) -> None:
        config = PreTrainedConfig.from_pretrained(folder)
        self._views, self._fingers = _observed(folder, config)
        config.device = "cpu"
        self.uses_instruction = config.type not in WITHOUT_LANGUAGE
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
        self._sentence = episode.instruction or task_spec(episode.task).summary

    def __call__(self, observation: Any) -> int:
        """The action for the newest frames of the preset, or for the state."""
        parts = observation if isinstance(observation, dict) else {self._views: observation}
        fingers = None
        if self._fingers:
            fingers = parts["fingers"] if "fingers" in parts else parts["state"][WHERE_FINGERS]
        batch: dict[str, Any] = {
            key: torch.from_numpy(np.ascontiguousarray(parts[view][..., -3:])).permute(2, 0, 1)[None].float() / 255
            for view, key in image_keys(self._views).items()
        } or {STATE_VECTOR: torch.from_numpy(parts["state"])[None]}
        batch["observation.state"] = torch.from_numpy(state(fingers))[None]
        # Policies draw from torch's own generator.
        with torch_settings(1), torch.inference_mode(), torch.random.fork_rng(devices=[]):
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
    observed = {name: tuple(feature.shape) for name, feature in config.input_features.items()}
    actions = {name: tuple(feature.shape) for name, feature in config.output_features.items()}
    known = {choice: _features(*choice) for choice in itertools.product(VIEWS, (False, True))}
    for choice, features in known.items():
        if observed == features and actions == {"action": (3,)}:
            return choice
    lines = "\n".join(f"  {features}" for features in known.values())
    raise SettingsError(
        f"the checkpoint {folder} makes {actions} of {observed}, and evaluations take {{'action': (3,)}} made of one of"
        f"\n{lines}\nTrain it on a data set of magical-mj demos export --to lerobot."
    )


def _features(views: str, fingers: bool) -> dict[str, tuple[int, ...]]:
    """Name -> shape of what a checkpoint sees."""
    pictures = dict.fromkeys(image_keys(views).values(), (3, IMAGE_SIZE, IMAGE_SIZE))
    entries = len(FINGERS if fingers else NO_STATE)
    return {**(pictures or {STATE_VECTOR: (len(STATE_NAMES),)}), "observation.state": (entries,)}
