"""The environments as a benchmark of vla-eval, the evaluation harness for vision-language-action models.

In its configuration, write ``benchmark: "magical_mj.integrations.vla_eval:MagicalBenchmark"``, and the class's
arguments as `params`. Episode n of a task is played in the scene of seed n, so 100 episodes per task play the official
scenes. The metrics are the mean score and the share of episodes with score 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import ArrayLike, NDArray

from magical_mj.actions import to_discrete, to_vector
from magical_mj.demos import Demonstration
from magical_mj.engine import Engine
from magical_mj.exports.lerobot import IMAGE_SIZE
from magical_mj.intents.by_set import set_of
from magical_mj.intents.given import GivenSettings, demonstrations_given, other_task, with_states
from magical_mj.intents.tasks import PREFIX
from magical_mj.observations import VIEWS
from magical_mj.scene.bodies import GRIPPER, check_body_name
from magical_mj.shifts.registry import Shifts, arms, split_body
from magical_mj.tasks.registry import environments, task_spec
from magical_mj.utils.errors import MissingExtraError, check_name

try:
    from vla_eval.benchmarks.base import StepBenchmark, StepResult  # pyright: ignore[reportMissingImports]
    from vla_eval.recording import NullEpisodeRecorder  # pyright: ignore[reportMissingImports]
    from vla_eval.specs import IMAGE_RGB, LANGUAGE, DimSpec  # pyright: ignore[reportMissingImports]
except ImportError:
    raise MissingExtraError("this needs vla-eval, 0.8 or newer: pip install vla-eval") from None

Pictures = dict[str, NDArray[np.uint8]]


class MagicalBenchmark(StepBenchmark):
    """A vla-eval task for each environment, such as ``FindDupe-Shape`` in the suite ``FindDupe``.

    Observations are ``images`` (view -> picture, height x width x channels, uint8) and ``task_description``. Actions
    are vectors (drive, turn, grip) in [-1, 1]. See `magical_mj.actions.to_discrete`.

    Args:
        tasks: names of tasks, separated by commas, or "all".
        variants: names of variants, separated by commas, or "all".
        views: any of "ego" and "allo", separated by commas.
        image_size: side of the pictures in pixels.
        shifts: shifts with strengths, such as "camera:3,latency:1". See docs/shifts.md.
        body: the robot's body. See docs/bodies.md.
        control: adds a vla-eval task for each environment without the shifts, such as ``FindDupe-Shape-unshifted``. It
            plays the same scenes.
        wrong_instruction: gives models the sentence of another intent, in the same scenes.
        demonstrations: the number of demonstrations that models receive with the first observation of an episode, as
            ``demonstrations``. Each has ``images``, which are pictures of all steps, and ``actions``, shape (steps, 3).
        scenes: the number of their demo scenes; by default that of the task.
        contrasting: chooses demo scenes that refute many other readings.

    Raises:
        UnknownNameError: for an unknown task, variant, view or shift.
        SettingsError, InvalidSceneError: if a task does not support the shifts or the body, or if there is a control
            without shifts.
    """

    render_backends = frozenset({"gpu", "cpu"})

    def __init__(
        self,
        tasks: str = "all",
        variants: str = "Demo",
        views: str = "ego",
        image_size: int = IMAGE_SIZE,
        shifts: Shifts = None,
        body: str = GRIPPER,
        *,
        control: bool = False,
        wrong_instruction: bool = False,
        demonstrations: int = 0,
        scenes: int | None = None,
        contrasting: bool = False,
    ) -> None:
        super().__init__()
        self._recorder = NullEpisodeRecorder()  # until an episode starts
        self._pairs = environments(tasks, variants)
        self._views = [view.strip() for view in views.split(",")]
        for view in self._views:
            check_name("view", view, VIEWS)
        self._size = image_size
        self._shifts, self._body = shifts, body
        self._arms = arms(shifts, control=control)
        for task, _ in self._pairs:
            check_body_name(split_body(shifts, task, body)[1])
        self._wrong_instruction = wrong_instruction
        self._instruction = ""
        self._given: dict[str, Sequence[Demonstration]] = {}
        if demonstrations:
            settings = GivenSettings(
                tasks=tasks, variants=variants, demonstrations=demonstrations, scenes=scenes, contrasting=contrasting
            )
            self._given = {task: with_states(made) for task, made in demonstrations_given(settings).items()}
        self._env: Engine | None = None

    @classmethod
    def configure_render(cls, mode: str) -> dict[str, str]:
        """Empty: no variables need to be set. The renderer is chosen at the first picture."""
        del mode
        return {}

    def get_tasks(self) -> list[dict[str, Any]]:
        """A vla-eval task for each environment."""
        return [
            {
                "name": f"{task}-{variant}{arm}",
                "suite": f"{set_of(task) if task.startswith(PREFIX) else task}{arm}",
                "task": task,
                "variant": variant,
                "shifts": shifts,
            }
            for arm, shifts in self._arms.items()
            for task, variant in self._pairs
        ]

    def reset(self, task: Mapping[str, Any]) -> Pictures:
        """Starts the episode in the scene of the seed ``task["episode_idx"]``."""
        self.cleanup()
        seed = int(task.get("episode_idx", 0))
        shifts = task.get("shifts", self._shifts)
        self._env = Engine(task["task"], task["variant"], seed=seed, shifts=shifts, body=self._body)
        self._instruction = self._env.instruction
        if self._wrong_instruction:
            other = other_task(task["task"], task["variant"], seed, self._body)
            self._instruction = task_spec(other).instruction
        return self._pictures(self._env)

    def step(self, action: Mapping[str, ArrayLike]) -> StepResult:
        """Performs an action. Raises an `InvalidActionError` if ``action["actions"]`` is not three finite numbers."""
        env = self._started()
        over = env.step(to_discrete(action["actions"]))
        score = env.score() if over else 0.0
        self._recorder.record_step(reward=score, done=over, success=score == 1.0)
        return StepResult(obs=self._pictures(env), reward=score, done=over, info={})

    def make_obs(self, raw_obs: Pictures, task: Mapping[str, Any]) -> dict[str, Any]:
        """The pictures and the instruction; at the start of an episode, also the demonstrations."""
        seen: dict[str, Any] = {"images": raw_obs, "task_description": self._instruction}
        if self._started().steps == 0 and self._given:
            seen["demonstrations"] = [self._shown(demo) for demo in self._given[task["task"]]]
        return seen

    def get_step_result(self, step_result: StepResult) -> dict[str, Any]:
        """The result of the finished episode."""
        return {"success": step_result.reward == 1.0, "score": step_result.reward}

    def get_metric_keys(self) -> dict[str, str]:
        """The metrics, and how they are aggregated over episodes."""
        return {"score": "mean", "success": "mean"}

    def get_metadata(self) -> dict[str, Any]:
        """The length of the longest episode, and of actions. Each episode ends at its task's horizon."""
        bodies = {task: split_body(self._shifts, task, self._body)[1] for task, _ in self._pairs}
        longest = max(task_spec(task).horizon(body=body) for task, body in bodies.items())
        return {"max_steps": longest, "action_dim": 3}

    def get_hold_action(self, last_action: Mapping[str, Any] | None) -> dict[str, Any]:
        """The action while the model computes in real time: the robot stops, and keeps the last gripper command."""
        grip = 0.0 if last_action is None else np.asarray(last_action["actions"]).reshape(-1)[2]
        return {"actions": np.array([0.0, 0.0, grip], np.float32)}

    def get_action_spec(self) -> dict[str, DimSpec]:
        """The specification of actions: drive, turn, grip."""
        return {"action": DimSpec("action", 3, "drive_turn_grip", (-1.0, 1.0))}

    def get_observation_spec(self) -> dict[str, DimSpec]:
        """The specification of observations: pictures and an instruction."""
        return {"image": IMAGE_RGB, "language": LANGUAGE}

    def cleanup(self) -> None:
        """Frees the simulation."""
        if self._env is not None:
            self._env.close()
        self._env = None

    def _shown(self, demo: Demonstration) -> dict[str, Any]:
        """A demonstration as models receive it."""
        frames: dict[str, list[NDArray[np.uint8]]] = {view: [] for view in self._views}
        with closing(Engine(demo.task, demo.variant, scene=demo.scene)) as engine:
            for action in demo.actions:
                for view in self._views:
                    frames[view].append(engine.render(view, self._size))
                engine.step(action)
        images = {view: np.stack(pictures) for view, pictures in frames.items()}
        return {"images": images, "actions": to_vector(demo.actions)}

    def _started(self) -> Engine:
        """The engine of the current episode."""
        if self._env is None:
            raise ResetNeeded("no episode has begun: call reset first")
        return self._env

    def _pictures(self, engine: Engine) -> Pictures:
        pictures = {view: engine.render(view, self._size) for view in self._views}
        self._recorder.record_video(pictures[self._views[0]])
        return pictures
