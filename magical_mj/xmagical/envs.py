"""x-magical's task SweepToTop in Gymnasium's API, and all other tasks with x-magical's bodies and actions."""

from __future__ import annotations

from functools import partial
from typing import Any, Final, Literal, get_args

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from magical_mj.envs.gymnasium_env import STARTS, MagicalEnv, Observation
from magical_mj.envs.old_names import with_old_names
from magical_mj.envs.presets import Preset
from magical_mj.envs.vector import make_vector
from magical_mj.scene.bodies import GRIPPER
from magical_mj.tasks.spec import Rules
from magical_mj.utils.errors import InvalidSeedError, check_name
from magical_mj.variants import check_seed
from magical_mj.xmagical.sweep_to_top import (
    REWARDS,
    SPEC,
    RewardKind,
    arrived,
    dense_reward,
    original_scene,
    state_vector,
)

ObservationKind = Literal["State", "Pixels"]
View = Literal["Allo", "Ego"]
OBSERVATIONS: Final[tuple[ObservationKind, ...]] = get_args(ObservationKind)
SEEDS: Final = ("protocol", "original")
STATE_BOUND: Final = 1.25
"""The bound of all entries of the state vector: positions reach 1.1, and debris can be pressed into walls a little."""
IMAGE_SIZE: Final = 384
MAX_SEEDS: Final = 2**32
"""The number of seeds of numpy's `RandomState`, the original's random generator."""


class SpeedsEnv(MagicalEnv):
    """A task with one of x-magical's bodies; make it with `gymnasium.make("magical_mj/MatchRegions-Longstick-...")`.

    ## Actions
    Vectors of speeds, as in `XMagicalEnv`.

    ## Observations
    "State": the state vector (`magical_mj.observations.STATE_NAMES`). "Pixels": a picture.

    ## Episodes
    As in `magical_mj.MagicalEnv`.

    Args:
        task: one of `magical_mj.TASKS`.
        body: one of `magical_mj.scene.bodies.BODIES`.
        variant: one of the task's variants.
        observation: "State" or "Pixels".
        view: "Allo" or "Ego", the view of pictures, and of what `render` draws.
        reward: "sparse", at every step the score if the episode ended now, or "dense", as in `magical_mj.MagicalEnv`.
        render_view: the view of `render` instead: "ego", "allo", "both" or "scene".
        settings: other arguments of `magical_mj.MagicalEnv`, such as `image_size`, `rules`, `renderer` and `shifts`.
    """

    @with_old_names
    def __init__(
        self,
        task: str,
        body: str = GRIPPER,
        variant: str = "Demo",
        observation: ObservationKind = "State",
        view: View = "Allo",
        *,
        reward: RewardKind = "sparse",
        render_view: str = "",
        **settings: Any,
    ) -> None:
        check_name("kind of observation", observation, OBSERVATIONS)
        check_name("view", view, get_args(View))
        check_name("reward", reward, REWARDS)
        camera = view.lower()
        super().__init__(
            task,
            variant,
            "State" if observation == "State" else Preset(((camera, 1),), "hwc", IMAGE_SIZE, "one picture"),
            body=body,
            reward="none" if reward == "sparse" else "dense",
            action="speeds",
            render_view=render_view or camera,
            **settings,
        )
        self.rewards: RewardKind = reward

    def _reward(self, info: dict[str, Any]) -> float:
        return super()._reward(info) if self.rewards == "dense" else self.score()


class XMagicalEnv(SpeedsEnv):
    """SweepToTop of x-magical; make it with `gymnasium.make("magical_mj/SweepToTop-...")`.

    ## Actions
    `Box(-1, 1, (2,))`, with a gripper `(3,)`. The entries are: the speed in units/s, with full speed from 0.8; the turn
    in rad relative to the heading, with full speed from 0.0625; and the closing angle of the fingers in rad, open up to
    0 and closed from 0.3927. One action lasts 1/8 s.

    ## Observations
    "State": `magical_mj.xmagical.sweep_to_top.state_vector`, shape (16,), with a gripper (17,). "Pixels": a picture.

    ## Episodes
    An episode is truncated after 100 steps, with the long stick after 50, and never terminates. At the last step,
    `info["eval_score"]` is the score in [0, 1], and `info["is_success"]` is whether it is 1. Before, `eval_score` is
    0.0. `info["in_zone"]` says for each debris whether it is in the zone. Resets, states and scenes are those of
    `magical_mj.MagicalEnv`.

    Args:
        body: one of `magical_mj.scene.bodies.BODIES`.
        variant: one of the six variants of SweepToTop.
        observation: "State" or "Pixels".
        view: "Allo" or "Ego", the view of observations and of `render`.
        reward: "sparse", the score at every step, or "dense", minus the mean distance of the debris to the top.
        seeds: "protocol", or "original" for the scenes that x-magical draws from its seeds.
        rules: "paper", or "released" for the original's observation space. Positions can exceed its bounds.
        render_view: another view of `render`: "ego", "allo", "both" or "scene".
        image_size, renderer, render_mode, render_size, limit: as in `magical_mj.MagicalEnv`.
    """

    @with_old_names
    def __init__(
        self,
        body: str = GRIPPER,
        variant: str = "Demo",
        observation: ObservationKind = "State",
        view: View = "Allo",
        *,
        image_size: int | None = None,
        reward: RewardKind = "sparse",
        seeds: Literal["protocol", "original"] = "protocol",
        rules: Rules = "paper",
        renderer: str | None = None,
        render_mode: str | None = None,
        render_view: str = "",
        render_size: int = IMAGE_SIZE,
        limit: int | None = None,
    ) -> None:
        check_name("kind of seeds", seeds, SEEDS)
        super().__init__(
            SPEC.name,
            body,
            variant,
            observation,
            view,
            reward=reward,
            image_size=image_size,
            rules=rules,
            renderer=renderer,
            render_mode=render_mode,
            render_view=render_view,
            render_size=render_size,
            limit=limit,
        )
        self.reward = "none"  # `_reward` computes x-magical's rewards instead
        self._original = np.random.RandomState(0) if seeds == "original" else None  # the first reset seeds it
        if observation == "State":
            bound = 1.0 if rules == "released" else STATE_BOUND
            self.observation_space = spaces.Box(-bound, bound, self.state_vector().shape, np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None, out: Observation | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode; see `magical_mj.MagicalEnv.reset`.

        With original seeds, a reset without a seed continues with the generator of the last seed.

        Raises:
            InvalidSeedError: if an original seed is not below 2**32.
        """
        if self._original is None or not isinstance(options or {}, dict) or (options or {}).keys() & {*STARTS}:
            return super().reset(seed=seed, options=options, out=out)
        if seed is not None or not self._begun:
            number = int(self.np_random.integers(MAX_SEEDS)) if seed is None else check_seed(seed)
            if number >= MAX_SEEDS:
                raise InvalidSeedError(
                    f"x-magical's seeds must be below 2**32, not {seed}; larger seeds need seeds='protocol'"
                )
            self._original = np.random.RandomState(number)
        scene = original_scene(self.engine.variant, self._original, self.engine.setup.body)
        return super().reset(seed=seed, options={**(options or {}), "scene": scene}, out=out)

    def _reward(self, info: dict[str, Any]) -> float:
        return float(info["in_zone"].mean()) if self.rewards == "sparse" else dense_reward(self.scene)

    def state_vector(self) -> NDArray[np.float32]:
        """x-magical's state vector."""
        return state_vector(self.scene)

    def _info(self, *, last: bool) -> dict[str, Any]:
        inside = arrived(self.scene)
        score = float(inside.mean()) if last else 0.0
        return {"eval_score": np.float64(score), "is_success": bool(score == 1.0), "in_zone": inside}


make_suite_vector: Final = partial(make_vector, XMagicalEnv)
make_speed_vector: Final = partial(make_vector, SpeedsEnv)
"""The vector entry points of the ids, which `gymnasium.make_vec` calls."""
