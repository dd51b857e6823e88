"""The environments in LeRobot's commands, and LeRobot's checkpoints in this package's evaluation.

Options of LeRobot's commands:

- ``--env.discover_packages_path=magical_mj.integrations.lerobot`` imports this module.
- ``--env.type=magical --env.task=FindDupe --env.variant=Layout`` selects environments. Comma-separated lists make one
  suite for each task.
- ``--env.views=ego``, ``allo``, ``both`` or ``state`` selects the observations.
- ``--env.fingers=true`` adds the angles of the two fingers.
- ``--env.shifts=camera:3,latency:1`` applies shifts (docs/shifts.md). Policies receive the episode's instruction.
- ``--env.control=true`` adds a suite for each task without the shifts, such as ``FindDupe-unshifted``.
- ``--env.body=shortstick`` selects the robot's body (docs/bodies.md).
- ``--seed=0 --eval.n_episodes=100`` plays the scenes of seeds 0 to 99.

Observations are ``pixels`` (96 px, height x width x channels, uint8; with both views a dict) or ``environment_state``
(the state vector), and ``agent_pos`` (the angles of the fingers, or three zeros). Actions are vectors (drive, turn,
grip). The reward of the last step is the score, all others are 0.
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

from magical_mj.actions import to_discrete
from magical_mj.envs.gymnasium_env import MagicalEnv
from magical_mj.envs.presets import STATE_BOUND
from magical_mj.exports.lerobot import (
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
from magical_mj.observations import FINGERS as FINGER_ENTRIES
from magical_mj.observations import STATE_NAMES
from magical_mj.policies.interface import NEUTRAL, Episode
from magical_mj.policies.models import torch_settings
from magical_mj.scene import constants as c
from magical_mj.scene.bodies import GRIPPER
from magical_mj.shifts.registry import Shifts, arms
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
    """An environment with LeRobot's names and shapes of observations.

    Args:
        task: a task's name.
        variant: a variant's name.
        views: "ego", "allo" or "both" for pictures, or "state" for the state vector.
        fingers: whether ``agent_pos`` contains the angles of the fingers (rad), shape (2,), or three zeros.
        shifts: shifts with strengths, such as "camera:3,latency:1". See docs/shifts.md.
        body: the robot's body. See docs/bodies.md.

    Raises:
        UnknownNameError: for an unknown task, variant, choice of views or shift.
        SettingsError, InvalidSceneError: if the task does not support the shifts or the body.
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
        settings: dict[str, Any] = {"action": "continuous", "render_mode": "rgb_array", "shifts": shifts, "body": body}
        env = MagicalEnv(task, variant, "State", reward="score", **settings)
        super().__init__(cast("gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]", env))
        self._engine, self._views, self._with_fingers = env.engine, VIEWS[views], fingers
        self.task = task
        self._max_episode_steps = self._engine.horizon
        parts: dict[str, spaces.Space[Any]] = {"environment_state": env.observation_space}
        if self._views:
            picture = spaces.Box(0, 255, (IMAGE_SIZE, IMAGE_SIZE, 3), np.uint8)
            pictures = spaces.Dict(dict.fromkeys(self._views, picture))
            parts = {"pixels": picture if len(self._views) == 1 else pictures}
        state_shape = (len(FINGERS if fingers else NO_STATE),)
        self.observation_space = spaces.Dict(
            {**parts, "agent_pos": spaces.Box(-STATE_BOUND, STATE_BOUND, state_shape, np.float32)}
        )

    @property
    def task_description(self) -> str:
        """The sentence that describes the task in this episode, including its shift."""
        return self._engine.instruction

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Starts an episode. Only the option "scene" is used, because LeRobot passes options of its own."""
        known = {name: value for name, value in (options or {}).items() if name == "scene"}
        return super().reset(seed=seed, options=known)

    def observation(self, observation: NDArray[np.float32]) -> dict[str, Any]:
        """LeRobot's observation of the current state, from its state vector."""
        parts: dict[str, Any] = {"environment_state": observation}
        if self._views:
            pictures = {view: self._engine.render(view, IMAGE_SIZE) for view in self._views}
            parts = {"pixels": pictures if len(pictures) > 1 else pictures[self._views[0]]}
        return {**parts, "agent_pos": state(observation[FINGER_ENTRIES] if self._with_fingers else None)}


@EnvConfig.register_subclass("magical")
@dataclass
class MagicalConfig(EnvConfig):
    """The options of ``--env.type=magical``: the environments and their observations."""

    task: str | None = "MoveToRegion"
    variant: str = "Demo"
    views: str = "ego"
    fingers: bool = False
    shifts: str = ""
    control: bool = False
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
        """Empty, since `create_envs` creates the environments."""
        return {}

    def create_envs(
        self, n_envs: int, use_async_envs: bool = False
    ) -> dict[str, dict[int, gymnasium.vector.VectorEnv[Any, Any, Any]]]:
        """Creates the environments: task (and "-unshifted") -> number of the variant -> vector environment."""
        mode = gymnasium.vector.AutoresetMode.SAME_STEP
        suites: dict[str, dict[int, gymnasium.vector.VectorEnv[Any, Any, Any]]] = {}
        settings: dict[str, Any] = {"fingers": self.fingers, "body": self.body}
        played = itertools.product(
            arms(self.shifts, control=self.control).items(), environments(self.task or "all", self.variant)
        )
        for (arm, settings["shifts"]), (task, variant) in played:
            make = [partial(LeRobotEnv, task, variant, self.views, **settings)] * n_envs
            suite = suites.setdefault(f"{task}{arm}", {})
            if use_async_envs and n_envs > 1:  # spawned, because OpenGL does not work after a fork
                vector: Any = gymnasium.vector.AsyncVectorEnv(make, context="spawn", autoreset_mode=mode)
            else:
                vector = gymnasium.vector.SyncVectorEnv(make, autoreset_mode=mode)
            suite[len(suite)] = vector
        return suites


WITHOUT_LANGUAGE: Final = ("act", "diffusion", "gaussian_actor", "tdmpc", "vqbet")
"""The types of LeRobot policies that do not read the instruction. LeRobot passes it to all policies."""


class LeRobotPolicy:
    """A policy for `magical_mj.evaluate` from a LeRobot checkpoint. Each episode starts a new action chunk.

    Attributes:
        uses_instruction: whether it reads the sentence that describes the task.
        preset: the preset of its observations. Only the newest frames of stacks are used.
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
        """Discards the action chunk of the last episode, and seeds the policy's noise with the episode's seed."""
        self._noise = torch.Generator().manual_seed(int(episode.rng().integers(2**63))).get_state()
        self._policy.reset()
        own = "" if episode.task == NEUTRAL else task_spec(episode.task).instruction
        self._sentence = episode.instruction or own

    def __call__(self, observation: Any) -> int:
        """The action for an observation of the preset."""
        parts = observation if isinstance(observation, dict) else {self._views: observation}
        fingers = None
        if self._fingers:
            fingers = parts["fingers"] if "fingers" in parts else parts["state"][FINGER_ENTRIES]
        batch: dict[str, Any] = {
            key: torch.from_numpy(np.ascontiguousarray(parts[view][..., -3:])).permute(2, 0, 1)[None].float() / 255
            for view, key in image_keys(self._views).items()
        } or {STATE_VECTOR: torch.from_numpy(parts["state"])[None]}
        batch["observation.state"] = torch.from_numpy(state(fingers))[None]
        # policies draw from torch's global generator, which must not change
        with torch_settings(1), torch.inference_mode(), torch.random.fork_rng(devices=[]):
            torch.set_rng_state(self._noise)
            action = self._after(self._policy.select_action(self._before({**batch, "task": [self._sentence]})))
            self._noise = torch.get_rng_state()
        return to_discrete(action[0].numpy())


def load_checkpoint(folder: Path | str) -> LeRobotPolicy:
    """The policy in a LeRobot checkpoint's folder ``pretrained_model``. Its weights are safetensors.

    Raises:
        SettingsError: if its observations or actions are not those of this package.
    """
    return LeRobotPolicy(Path(folder))


def _observed(folder: Path, config: Any) -> tuple[str, bool]:
    """A checkpoint's choice of `VIEWS`, and whether it observes the angles of the fingers."""
    observed = {name: tuple(feature.shape) for name, feature in config.input_features.items()}
    actions = {name: tuple(feature.shape) for name, feature in config.output_features.items()}
    known = {choice: _features(*choice) for choice in itertools.product(VIEWS, (False, True))}
    for choice, features in known.items():
        if observed == features and actions == {"action": (3,)}:
            return choice
    lines = "\n".join(f"  {features}" for features in known.values())
    raise SettingsError(
        f"the checkpoint {folder} has the outputs {actions} and the inputs {observed}. Evaluations need the outputs "
        f"{{'action': (3,)}} and one of these inputs:\n{lines}\n"
        "Train it on a data set of magical-mj demos export --to lerobot."
    )


def _features(views: str, fingers: bool) -> dict[str, tuple[int, ...]]:
    """The names and shapes of a checkpoint's inputs."""
    pictures = dict.fromkeys(image_keys(views).values(), (3, IMAGE_SIZE, IMAGE_SIZE))
    entries = len(FINGERS if fingers else NO_STATE)
    return {**(pictures or {STATE_VECTOR: (len(STATE_NAMES),)}), "observation.state": (entries,)}
