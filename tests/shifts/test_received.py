"""What a policy receives under each shift, through every interface: pictures, the sentence, effects of its actions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from functools import cache
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import magical_mj
from magical_mj.evaluation import Episode, rollouts
from magical_mj.shifts import SHIFTS, Shift
from magical_mj.shifts.registry import effects
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import SettingsError
from tests.helpers.commands import Shell

TASK, SEED = "FixColour", 3
ACTIONS = magical_mj.demos.load(TASK)[0].actions.tolist()
"""They push a block."""
STACKED: dict[str, Any] = {"preset": "LoResStack", "renderer": "software"}
Received = tuple[list[bytes], set[str]]
"""The newest frame of both views before each action, and all sentences that said what is to be done."""


class Reader:
    """Plays `ACTIONS`, and keeps what it has received in its last episode."""

    uses_instruction = True

    def reset(self, episode: Episode) -> None:
        self.pictures: list[bytes] = []
        self.sentences = {episode.instruction}

    def __call__(self, observation: Any) -> int:
        self.pictures.append(newest(observation))
        self.sentences.add(observation["instruction"])
        return ACTIONS[len(self.pictures) - 1]


class Readers:
    """Acts in several episodes at once, and keeps their sentences."""

    uses_instruction = True

    def __init__(self) -> None:
        self.sentences: list[tuple[str, ...]] = []

    def reset_batch(self, episodes: Sequence[Episode]) -> None:
        self.sentences.append(tuple(episode.instruction for episode in episodes))

    def act_batch(self, observations: Any) -> list[int]:
        assert observations["instruction"] == self.sentences[-1]
        return [0] * len(observations["ego"])

    def __call__(self, observation: Any) -> int:
        raise AssertionError("it plays several episodes at once")


class Shouted(Shift):
    """A shift of one's own of the sentence."""

    name = "shouted"

    def instruction(self, instruction: str, task: str) -> str:
        return instruction.upper()


def newest(observation: Any) -> bytes:
    return b"".join(np.ascontiguousarray(observation[view][..., -3:]).tobytes() for view in ("ego", "allo"))


@cache
def by_engine(shifts: str) -> Received:
    with closing(magical_mj.Engine(TASK, seed=SEED, shifts=shifts, renderer="software")) as env:
        pictures = []
        for action in ACTIONS:
            pictures.append(b"".join(env.render(view, 96).tobytes() for view in ("ego", "allo")))
            env.step(action)
        return pictures, {env.instruction}


def by_evaluation(shifts: str) -> Received:
    policy = Reader()
    few = {"tasks": TASK, "variants": "Demo", "first_seed": SEED, "episodes": 1, "jobs": 1, "shifts": shifts}
    played = magical_mj.evaluate(policy, **few, **STACKED)
    assert played["failure"].isna().all()
    assert list(played["shift"]) == list(dict.fromkeys(["", shifts]))
    return policy.pictures, policy.sentences


def by_gymnasium(shifts: str) -> Received:
    env: Any = gymnasium.make(f"magical_mj/{TASK}-Demo-v0", shifts=shifts, instruction=True, **STACKED)
    pictures, (observation, info) = [], env.reset(seed=SEED)
    sentences = {env.unwrapped.instruction, str(info["instruction"]), observation["instruction"]}
    for action in ACTIONS:
        pictures.append(newest(observation))
        observation, *_, info = env.step(action)
        sentences |= {str(info["instruction"]), observation["instruction"]}
    env.close()
    return pictures, sentences


def by_vector(shifts: str) -> Received:
    envs = magical_mj.make_vec(TASK, 2, shifts=shifts, instruction=True, autoreset_mode="Disabled", **STACKED)
    pictures, (observations, infos) = [], envs.reset(seed=[SEED + 1, SEED])
    sentences = {envs.get_attr("instruction")[1], observations["instruction"][1], str(infos["instruction"][1])}
    for action in ACTIONS:
        pictures.append(newest({view: observations[view][1] for view in ("ego", "allo")}))
        observations, *_ = envs.step(np.array([0, action]))
    envs.close()
    return pictures, sentences


def by_composer(shifts: str) -> Received:
    pytest.importorskip("dm_control", reason="dm_control does not install with this Python or MuJoCo")
    env: Any = magical_mj.load(TASK, seed=SEED, shifts=shifts, renderer="software")
    step, pictures = env.reset(), []
    for action in ACTIONS:
        pictures.append(newest(step.observation))
        step = env.step(action)
    return pictures, {env.instruction}


@pytest.mark.parametrize("axis", ["", *SHIFTS])
def test_every_interface_hands_on_what_a_shift_changes(axis: str) -> None:
    plain, label = by_engine(""), f"{axis}:5" if axis else ""
    shifted = by_engine(label)
    changed = effects(SHIFTS[axis]) if axis else frozenset()
    assert (shifted[0] != plain[0]) == bool(changed & {"simulation", "pictures"})
    assert (shifted[1] != plain[1]) == ("instruction" in changed)
    interfaces: list[Callable[[str], Received]] = [by_evaluation, by_gymnasium, by_vector, by_composer]
    for receive in interfaces:
        assert receive(label) == shifted, receive.__name__


@pytest.mark.parametrize("shift", ["words:5", f"{__name__}:Shouted:1"])
@pytest.mark.parametrize("kind", ["sync", "vector_entry_point"])
def test_each_of_several_episodes_has_its_own_sentence(kind: str, shift: str) -> None:
    settings: dict[str, Any] = {"shifts": shift, "instruction": True, **STACKED}
    envs = gymnasium.make_vec(f"magical_mj/{TASK}-Demo-v0", 2, kind, **settings)
    episodes, policy = [Episode(TASK, "Demo", seed) for seed in (1, 2, 3)], Readers()
    assert [each.failure for each in rollouts(envs, policy, episodes)] == [None] * 3
    envs.close()
    wanted = [magical_mj.Engine(TASK, seed=seed, shifts=shift).instruction for seed in (1, 2, 3)]
    assert task_spec(TASK).instruction not in wanted
    assert policy.sentences == [(wanted[0], wanted[1]), (wanted[2], wanted[2])]
    env: Any = gymnasium.make(f"magical_mj/{TASK}-Demo-State-v0", shifts=shift)
    assert str(env.reset(seed=3)[1]["instruction"]) == str(env.step(0)[-1]["instruction"]) == wanted[2]


def test_asynchronous_vectors_hand_on_sentences() -> None:
    """Gymnasium would keep the text that shared memory contains before the first episode."""
    how: dict[str, Any] = {"shifts": "words:5", "instruction": True, **STACKED}
    name = f"magical_mj:magical_mj/{TASK}-Demo-v0"
    with pytest.raises(ValueError, match="shared_memory=False"):
        gymnasium.make_vec(name, 1, "async", vector_kwargs={"context": "spawn"}, **how)
    envs = gymnasium.make_vec(name, 1, "async", vector_kwargs={"context": "spawn", "shared_memory": False}, **how)
    try:
        for seed in (SEED, SEED + 1):
            observations, _ = envs.reset(seed=seed)
            wanted = magical_mj.Engine(TASK, seed=seed, shifts="words:5").instruction
            assert observations["instruction"] == (wanted,) == envs.step(np.array([0]))[0]["instruction"]
    finally:
        envs.close()


def blind(observation: Any) -> int:
    """Sees pictures, and reads nothing."""
    return 0


def test_a_shift_that_a_policy_does_not_notice_is_refused(tmp_path: Path) -> None:
    few: dict[str, Any] = {"tasks": "MoveToRegion", "variants": "Demo", "episodes": 1, "jobs": 1}
    for policy in ("noop", "expert", blind):
        for shifts in ("words:5", "camera:2+words:1", f"{__name__}:Shouted:1"):
            with pytest.raises(SettingsError, match=r"does not notice the shift .*(words|Shouted): .*uses_instruction"):
                magical_mj.evaluate({"it": policy}, shifts=shifts, out=tmp_path / "out", **few)
    with pytest.raises(SettingsError, match="blind does not notice the shift words"):
        magical_mj.evaluate({"reader": Reader(), "blind": blind}, shifts="words:5", **few, **STACKED)
    with pytest.raises(SettingsError, match="notice the shift camera: it changes pictures, and the observations have"):
        magical_mj.evaluate(blind, shifts="camera:2+latency:1", preset="State", **few)
    assert not (tmp_path / "out").exists()
    name, episodes = f"magical_mj/{TASK}-Demo-LoRes4E-v0", [Episode(TASK, "Demo", 0)]
    for env in (gymnasium.make(name, shifts="words:5"), gymnasium.make_vec(name, 1, "sync", shifts="words:5")):
        with pytest.raises(SettingsError, match="blind does not notice the shift words"):
            list(rollouts(env, blind, episodes))
        env.close()


def test_all_shifts_are_those_that_the_policies_notice(tmp_path: Path) -> None:
    def axes(policy: Any, preset: str) -> set[str]:
        evaluation = magical_mj.evaluation.Evaluation(
            policy,
            magical_mj.evaluation.EvaluationSettings(
                tasks="MoveToRegion", variants="Demo", episodes=1, shifts="all", preset=preset, out=tmp_path / "out"
            ),
        )
        labels = {unit.shift for unit in evaluation.units}
        assert labels == set(evaluation.settings.recorded(evaluation.sources)["shifts"])
        return {label.partition(":")[0] for label in labels} - {""}

    every, drawn = set(SHIFTS), {"camera", "light", "texture", "palette", "sensor"}
    assert axes(Reader(), "LoResStack") == every
    assert axes(blind, "LoRes4E") == axes({"a": Reader(), "b": blind}, "LoResStack") == every - {"words"}
    assert axes(blind, "State") == every - {"words"} - drawn
    assert axes("noop", "State") == every - {"words"}, "it looks at nothing, with any preset"


def test_rollout_refuses_it_too(shell: Shell) -> None:
    message = shell.fails(2, "rollout", "MoveToRegion", "--policy", "noop", "--shifts", "words:5")
    assert "noop does not notice the shift words" in message
