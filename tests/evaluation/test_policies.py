"""Users' policies, environments and wrappers: their state, processes and errors; and tasks that are like another."""

from __future__ import annotations

import multiprocessing
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from numpy.typing import NDArray

import magical_mj
from magical_mj.actions import action_number
from magical_mj.cli.film import film_episodes
from magical_mj.evaluation import Episode, EvaluationSettings, rollouts
from magical_mj.evaluation.replay import replay
from magical_mj.evaluation.reports.report import report
from magical_mj.evaluation.reports.results import compare
from magical_mj.evaluation.scores import SCORES, read
from magical_mj.leaderboard import submit
from magical_mj.policies.loading import sources
from magical_mj.utils.errors import ClosedError, EvaluationError, InvalidActionError, SettingsError, TaskError
from tests.helpers import agents
from tests.helpers.agents import Acting
from tests.helpers.commands import Shell
from tests.helpers.evaluations import SMALL, TEMPLATE, evaluate

STATE: dict[str, Any] = {"preset": "State"}
SINGLY: dict[str, Any] = {"autoreset_mode": gymnasium.vector.AutoresetMode.DISABLED}


class Remembering:
    """Counts its steps, and can be reset only for several episodes at once."""

    def reset_batch(self, episodes: Sequence[Episode]) -> None:
        self.steps = 0

    def act_batch(self, observations: Any) -> list[int]:
        self.steps += 1
        return [self.steps % 18] * len(observations)

    def __call__(self, observation: Any) -> int:
        return self.act_batch([observation])[0]


@dataclass
class Linear:
    """Holds arrays, so that its comparison is ambiguous."""

    weights: NDArray[Any] = field(default_factory=lambda: np.arange(3.0))

    def __call__(self, observation: Any) -> int:
        return int(self.weights.sum())


class Forking:
    """Starts a process that continues after it."""

    def __init__(self) -> None:
        self.helper: Any = None

    def __call__(self, observation: Any) -> int:
        if self.helper is None:
            self.helper = multiprocessing.get_context("fork").Process(target=time.sleep, args=(60,), daemon=True)
            self.helper.start()
        return 0


@pytest.mark.parametrize("episodes", [1, 3])
def test_a_policy_for_batches_starts_every_episode_anew(episodes: int) -> None:
    assert set(evaluate(Remembering(), episodes=episodes, **STATE)["actions"].str[:3]) == {"bcd"}


def test_policies_need_not_be_comparable() -> None:
    played = evaluate(Linear(), jobs=2, **STATE)
    assert set(played["actions"]) == {"d" * 40}
    assert len(played) == 6


class MuteError(Exception):
    """Has a failing `repr`."""

    def __str__(self) -> str:
        raise AttributeError("message")


def fail_in_seed_1(episode: Episode) -> None:
    if episode.seed == 1:
        raise MuteError


def test_an_error_that_cannot_be_shown_costs_one_episode() -> None:
    failures = evaluate(Acting(reset=fail_in_seed_1), **STATE)["failure"].dropna()
    assert len(failures) == 2
    assert failures.str.startswith("MuteError: an error without a message (test_policies.py, line ").all()


def get_lost(episode: Episode) -> None:
    """Fails in the task with the longest episodes."""
    if episode.task == "ClusterShape":
        raise RuntimeError("lost")


def test_the_first_planned_episodes_decide_whether_a_policy_works(tmp_path: Path) -> None:
    kind: dict[str, Any] = {"tasks": "MoveToRegion,ClusterShape", "variants": "Demo", "episodes": 10, **STATE}
    with pytest.raises(EvaluationError, match=r"the first 10 episodes of pair, run 1, failed.*RuntimeError: lost"):
        magical_mj.evaluate({"pair": ["noop", Acting(reset=get_lost)]}, jobs=2, out=tmp_path, **kind)
    assert '"run": 1' not in (tmp_path / SCORES).read_text()


def test_processes_forked_by_a_policy_do_not_keep_the_scores_locked(tmp_path: Path) -> None:
    policy = Forking()
    first = evaluate(policy, out=tmp_path, **STATE)
    assert policy.helper.is_alive()
    try:
        assert evaluate(policy, out=tmp_path, resume=True, **STATE).equals(first)
    finally:
        policy.helper.terminate()


def test_a_file_that_changes_meanwhile_is_no_policy_of_the_evaluation(tmp_path: Path) -> None:
    torch, sb3 = pytest.importorskip("torch"), pytest.importorskip("stable_baselines3")
    env = gymnasium.make("magical_mj/MoveToRegion-Demo-State-v0")
    models = [sb3.PPO("MlpPolicy", env, n_steps=8, batch_size=8, device="cpu", seed=seed) for seed in (0, 1)]
    path, threads = tmp_path / "model.zip", torch.get_num_threads()
    models[0].save(path)
    played = []

    def overwrite(score: Any) -> None:
        played.append(score.policy)
        models[1].save(path)

    with pytest.raises(SettingsError, match=r"was changed while it was evaluated.*evaluate a copy"):
        magical_mj.evaluate({"A": str(path), "B": "noop"}, watch=overwrite, **SMALL)
    assert "A" in played
    assert torch.get_num_threads() == threads, "the caller's setting is left alone"


@pytest.fixture
def excessive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Tasks with a score above 1 in some scenes, a count rule that draws too many blocks, and a score that fails."""
    name = f"excessive_{tmp_path.name}"
    (tmp_path / f"{name}.py").write_text(
        "from dataclasses import replace\n"
        "from magical_mj.tasks.match_regions import SPEC as OURS\n"
        "def score(initial, final, rules):\n"
        "    return 2.0 if initial.robot.angle > OURS.demo.robot.angle else 0.0\n"
        "def count(rng, scene):\n"
        "    return replace(scene, blocks=scene.blocks[:1] * int(rng.integers(8, 13)))\n"
        'SPEC = replace(OURS, name="Excessive", score=score)\n'
        'CROWDED = replace(OURS, name="Crowded", count=count)\n'
        "def broken(initial, final, rules):\n"
        "    return 0.0 if final.robot == initial.robot else 1 / 0\n"
        'BROKEN = replace(OURS, name="Broken", score=broken)\n'
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path[:])
    monkeypatch.setattr(gymnasium, "registry", dict(gymnasium.registry))
    monkeypatch.setattr("gymnasium.envs.registration.registry", gymnasium.registry)
    yield name
    del sys.modules[name]


@pytest.mark.parametrize("kind", [Remembering, Linear])
def test_errors_of_a_task_do_not_count_as_failures_of_a_policy(excessive: str, kind: Any) -> None:
    with pytest.raises(TaskError, match=r"Excessive.score must return a number in \[0, 1\], but returned 2.0"):
        magical_mj.evaluate(kind(), tasks=f"{excessive}:SPEC", variants="Jitter", episodes=6, **STATE)
    with pytest.raises(TaskError, match=r"Broken.score failed: ZeroDivisionError: division by zero \(.*excessive_"):
        magical_mj.evaluate(kind(), tasks=f"{excessive}:BROKEN", variants="Demo", episodes=2, **STATE)
    with pytest.raises(
        TaskError, match=r"no episode can start in the scene of seed .*the state vector has entries for 10 blocks"
    ):
        magical_mj.evaluate(kind(), tasks=f"{excessive}:CROWDED", variants="CountPlus", episodes=8, **STATE)


@pytest.mark.parametrize("side_by_side", [False, True])
def test_errors_of_the_environment_do_not_count_as_failures_of_a_policy(side_by_side: bool) -> None:
    name = "magical_mj/MoveToRegion-Demo-State-v0"

    def make(kind: str = name, **settings: Any) -> Any:
        if side_by_side:
            return gymnasium.make_vec(kind, 2, vectorization_mode="sync", vector_kwargs=SINGLY, **settings)
        return gymnasium.make(kind, **settings).unwrapped

    def played(env: Any) -> list[Any]:
        return list(rollouts(env, Remembering(), [Episode("MoveToRegion", "Demo", 0)]))

    assert played(make())[0].failure is None
    with pytest.raises(EvaluationError, match=r"the environment takes .*Box.*to_discrete\(vector\)"):
        played(make(action="continuous"))
    with pytest.raises(EvaluationError, match="the environment is FixColour All, but an episode has MoveToRegion Demo"):
        played(make("magical_mj/FixColour-TestAll-State-v0"))
    with pytest.raises(EvaluationError, match="make one with an id that begins with magical_mj/"):
        played(make("CartPole-v1"))
    closed = make()
    closed.close()
    with pytest.raises((ClosedError, gymnasium.error.ClosedEnvironmentError)):
        played(closed)


def test_infos_that_a_wrapper_has_made_a_list_are_explained() -> None:
    envs = gymnasium.make_vec("magical_mj/MoveToRegion-Demo-State-v0", 2, vectorization_mode="sync")
    listed = gymnasium.wrappers.vector.DictInfoToList(envs)
    with pytest.raises(EvaluationError, match="infos must be a dict, not list"):
        list(rollouts(listed, Remembering(), [Episode("MoveToRegion", "Demo", 0)]))


class Exploding(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Makes the simulation of the first scene unstable."""

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        started = super().reset(seed=seed, options=options)
        if seed == 0:
            self.unwrapped.engine.data.qvel[:] = 1e30  # type: ignore[attr-defined]
        return started


def test_an_unstable_simulation_costs_one_episode() -> None:
    env = Exploding(gymnasium.make("magical_mj/MoveToRegion-Demo-State-v0"))
    first, second = rollouts(env, lambda _: 0, [Episode("MoveToRegion", "Demo", seed) for seed in (0, 1)])
    assert first.failure is not None
    assert first.failure.startswith("PhysicsError: ")
    assert second.failure is None


class TooFew:
    """Returns an action too few."""

    def reset_batch(self, episodes: Sequence[Episode]) -> None:
        """Returns no actions."""

    def act_batch(self, observations: Any) -> list[int]:
        return [0] * (len(observations) - 1)

    def __call__(self, observation: Any) -> int:
        return 1


def test_an_action_is_needed_for_each_environment() -> None:
    envs = gymnasium.make_vec("magical_mj/MoveToRegion-Demo-State-v0", 2, vectorization_mode="sync")
    (outcome,) = rollouts(envs, TooFew(), [Episode("MoveToRegion", "Demo", 0)])
    assert outcome.failure == "InvalidActionError: 1 actions for 2 environments"


def test_tasks_may_be_a_word_and_an_iterator() -> None:
    with pytest.raises(SettingsError, match="cannot act in MoveToRegion: give --tasks MoveToCorner"):
        evaluate(Acting(tasks="MoveToCorner"), **STATE)
    with pytest.raises(SettingsError, match=r"cannot act in intent:line\(all\): give --tasks MoveToCorner"):
        evaluate(Acting(tasks="MoveToCorner"), **(STATE | {"tasks": "intent:line(all)"}))
    settings = EvaluationSettings(tasks=(task for task in ("FindDupe", "MakeLine")), variants=iter(["Demo"]))
    assert settings.environments == settings.environments == [("FindDupe", "Demo"), ("MakeLine", "Demo")]


def test_names_may_hold_commas() -> None:
    named = sources(r"slowly\, twice=noop,random")
    assert [(source.name, source.origin) for source in named] == [("slowly, twice", "noop"), ("random", "random")]


class Skips(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Repeats each action four times."""

    def step(self, action: Any) -> Any:
        for _ in range(4):
            result = super().step(action)
            if result[3]:
                break
        return result


def test_a_wrapper_that_repeats_actions_is_explained() -> None:
    env = Skips(magical_mj.MagicalEnv("MoveToRegion", preset="State"))
    with pytest.raises(EvaluationError, match="a wrapper made 40 steps from 10 actions, and results need an action"):
        list(rollouts(env, Remembering(), [Episode("MoveToRegion", "Demo", 0)]))


def test_videos_of_methods_with_similar_names_are_kept_apart(tmp_path: Path) -> None:
    scores = [replace(TEMPLATE, policy=name, task="MoveToRegion", actions="a") for name in ("a/b", "a-b", 'a:?*"<|>b')]
    links = film_episodes([("best", score) for score in scores], tmp_path)
    assert len(links) == len(set(links.values())) == len(list(tmp_path.glob("*.mp4"))) == 3
    assert not any(set(link) & set('/\\:*?"<>|') for link in links.values())
    with pytest.raises(InvalidActionError, match="stored actions are letters from a to r, not 'abz'"):
        film_episodes([("best", replace(scores[0], actions="abz"))], tmp_path)


def test_episodes_may_come_one_by_one_and_must_be_of_the_environment() -> None:
    name = "magical_mj/MoveToRegion-Demo-State-v0"
    several = SyncVectorEnv([lambda: gymnasium.make(name)], autoreset_mode=AutoresetMode.DISABLED)
    for env in (gymnasium.make(name), several):
        outcomes = list(rollouts(env, Acting(lambda _: 1), (Episode("MoveToRegion", "Demo", seed) for seed in (0, 1))))
        assert [len(outcome.actions) for outcome in outcomes] == [40, 40]
        with pytest.raises(
            EvaluationError, match="the environment is MoveToRegion Demo, but an episode has MoveToCorner"
        ):
            list(rollouts(env, Acting(lambda _: 1), [Episode("MoveToCorner", "Demo", 0)]))
        env.close()


@pytest.mark.parametrize("mode", AutoresetMode)
def test_vector_environments_in_every_autoreset_mode(mode: AutoresetMode) -> None:
    name = "magical_mj:magical_mj/MoveToRegion-TestLayout-State-v0"
    episodes = [Episode("MoveToRegion", "Layout", seed) for seed in range(5)]
    processes = mode == AutoresetMode.NEXT_STEP  # each environment in its own process
    kwargs: dict[str, Any] = {"autoreset_mode": mode, **({"context": "spawn"} if processes else {})}
    envs = gymnasium.make_vec(name, 2, "async" if processes else "sync", vector_kwargs=kwargs)
    assert isinstance(envs, SyncVectorEnv | AsyncVectorEnv)
    results = {policy: list(rollouts(envs, policy(), episodes)) for policy in (agents.Counting, agents.Batch)}
    envs.close()
    for policy, side_by_side in results.items():
        plain = list(rollouts(gymnasium.make(name), policy(), episodes))
        assert [(r.key, r.score, r.actions, r.failure) for r in side_by_side] == [
            (r.key, r.score, r.actions, None) for r in plain
        ]


def test_results_do_not_depend_on_the_callers_floating_point_settings() -> None:
    name, episodes = "magical_mj/FindDupe-Demo-State-v0", [Episode("FindDupe", "Demo", seed) for seed in range(4)]
    env = gymnasium.make(name)
    usual = [(r.score, r.actions, r.failure) for r in rollouts(env, agents.Counting(), episodes)]
    with np.errstate(all="raise"):
        assert [(r.score, r.actions, r.failure) for r in rollouts(env, agents.Counting(), episodes)] == usual
    assert {failure for _, _, failure in usual} == {None}
    env.close()


MODULE = """
from dataclasses import replace
import gymnasium
from magical_mj.tasks.find_dupe import SPEC as OLD

class Dark(gymnasium.ObservationWrapper):
    def observation(self, observation):
        return 0 * observation

class Other(gymnasium.Wrapper):
    def __init__(self, env):
        super().__init__(env)
        self.action_space = gymnasium.spaces.Discrete(3)

def sum_is_even(observation):
    return int(observation.sum() != 0)

SPEC = replace(OLD, name="FindQuickly", like="FindDupe", plan=None, steps=50)
FAR = replace(SPEC, name="FindAnything", like="")
"""


@pytest.fixture(autouse=True)
def _module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    Path("mine.py").write_text(MODULE)


def test_a_wrapper_is_played_in_and_named(tmp_path: Path) -> None:
    plain, dark = (
        magical_mj.evaluate("mine:sum_is_even", out=name, wrap=wrap, jobs=1, **SMALL)
        for name, wrap in (("plain", ""), ("dark", "mine:Dark"))
    )
    assert (set(plain["actions"]), set(dark["actions"])) == ({"b" * 40}, {"a" * 40})
    assert {score.wrap for score in read(tmp_path / "dark")} == {"mine:Dark"}
    text = report([tmp_path / "plain", tmp_path / "dark"], tmp_path / "out").read_text()
    assert "| sum_is_even in mine:Dark |" in text
    assert compare(tmp_path / "plain", tmp_path / "dark").attrs["policies"][1] == "sum_is_even in mine:Dark"
    with pytest.raises(EvaluationError, match="was played in the wrapper mine:Dark"):
        submit([tmp_path / "dark"], tmp_path / "entry.json.xz")


def test_another_body_is_played_with_and_named(tmp_path: Path) -> None:
    settings: dict[str, Any] = {"variants": "Demo", "episodes": 1, "jobs": 1, "body": "shortstick"}
    frame = magical_mj.evaluate("expert", tasks="MoveToRegion", out="stick", **settings)
    assert (frame["score"].item(), frame["body"].item()) == (1.0, "shortstick")
    assert [problem for *_, problem in replay([("", score) for score in read(tmp_path / "stick")], jobs=1)] == [None]
    assert "| expert with shortstick |" in report([tmp_path / "stick"], tmp_path / "out").read_text()
    with pytest.raises(EvaluationError, match="with the body shortstick"):
        submit([tmp_path / "stick"], tmp_path / "entry.json.xz")
    with pytest.raises(SettingsError, match="the expert cannot solve FindDupe with the body"):
        magical_mj.evaluate("expert,noop", tasks="FindDupe", **{**settings, "body": "longstick"})


@pytest.mark.parametrize(
    ("wrap", "problem"),
    [
        ("Dark", "wrap must be package.module:NAME"),
        ("mine:nothing", "mine:nothing cannot be used: ImportError"),
        ("mine:OLD", "mine:OLD cannot be used: TypeError"),
        ("mine:sum_is_even", "mine:sum_is_even cannot be used: AttributeError"),
        ("mine:Other", "with the same 18 actions"),
    ],
)
def test_invalid_wrappers_are_refused(wrap: str, problem: str) -> None:
    with pytest.raises(SettingsError, match=problem):
        magical_mj.evaluate("noop", wrap=wrap, **SMALL)


def test_policies_play_a_task_that_is_like_theirs(shell: Shell) -> None:
    """Set by the task's definition, or by --as. The expert uses the plan of the other task."""
    settings: dict[str, Any] = {"variants": "Demo", "episodes": 1, "preset": "State", "jobs": 1}
    told: list[str] = []
    policy = Acting(reset=lambda episode: told.append(episode.task), tasks=("FindDupe",))
    frame = magical_mj.evaluate(policy, tasks="mine:SPEC", **settings)
    assert (told, frame["task"].item(), frame["steps"].item()) == (["FindDupe"], "mine:SPEC", 50)
    magical_mj.evaluate("expert", tasks="mine:SPEC", **settings)
    with pytest.raises(SettingsError, match=r"cannot act in mine:FAR: give --tasks FindDupe, or --as"):
        magical_mj.evaluate(policy, tasks="mine:FAR", **settings)
    magical_mj.evaluate(policy, tasks="mine:FAR", like="FindDupe", **settings)
    line = "evaluate --policy expert --tasks mine:FAR --variants Demo --episodes 1 --jobs 1 --out o"
    assert "FindAnything has no plan" in shell.fails(2, *line.split())
    assert shell(*line.split(), "--as", "FindDupe")[0] == 0
    assert "Did you mean 'FindDupe'" in shell.fails(2, *line.split(), "--as", "FindDup")


@pytest.mark.parametrize("jobs", [1, 2])
def test_errors_of_policies_are_chained_and_placed(jobs: int, tmp_path: Path) -> None:
    code = "def deep(x):\n    return {}[x]\n\ndef act(observation):\n    return deep('pose')\n"
    (tmp_path / "theirs.py").write_text(code)
    with pytest.raises(EvaluationError, match=r"KeyError: 'pose' \(theirs.py, line 2\)") as caught:
        magical_mj.evaluate("theirs:act", jobs=jobs, **SMALL)
    assert 'theirs.py", line 5, in act' in "".join(traceback.format_exception(caught.value))


def test_a_missing_package_does_not_count_as_a_failure() -> None:
    def act(observation: Any) -> int:
        import no_such_package  # noqa: F401

        return 0

    with pytest.raises(SettingsError, match=r"needs a missing package: ModuleNotFoundError: .*no_such_package"):
        magical_mj.evaluate(act, jobs=1, **SMALL)


@pytest.mark.parametrize(
    ("action", "hint"), [(np.array([4]), "its only entry"), (np.zeros(18), "argmax"), ([0.0] * 18, "argmax")]
)
def test_actions_that_are_arrays_get_a_hint(action: Any, hint: str) -> None:
    with pytest.raises(InvalidActionError, match=hint):
        action_number(action)


def _meddlers() -> dict[str, Callable[[Any], object]]:
    return {
        "steps": lambda env: env.step(4),
        "starts again": lambda env: env.reset(seed=1),
        "moves": lambda env: env.data.qpos.__iadd__(0.01),
        "ends later": lambda env: setattr(env, "limit", 100),
        "restores": lambda env: env.set_state(env.clone().get_state()) or env.step(4),
    }


@pytest.mark.parametrize("meddle", _meddlers())
def test_a_policy_with_the_simulation_must_not_change_the_episode(meddle: str) -> None:
    """Its actions would not lead to the recorded score. In copies it may do anything."""

    class Planner:
        uses_simulation = True

        def reset(self, episode: Episode) -> None:
            self.env, self.calls = episode.env, 0

        def __call__(self, _: Any) -> int:
            self.calls += 1
            assert self.env is not None
            seed = self.env.seed
            _meddlers()[meddle](self.env if seed == 1 and self.calls == 3 else self.env.clone())
            return 4

    rows = magical_mj.evaluate(Planner(), tasks="MoveToRegion", variants="Jitter", episodes=3, jobs=1)
    plain = magical_mj.evaluate(lambda _: 4, tasks="MoveToRegion", variants="Jitter", episodes=3, jobs=1)
    assert rows["failure"].isna().tolist() == [True, False, True]
    assert (
        "the policy changed the episode in episode.env: let it try actions in episode.env.clone()" in rows["failure"][1]
    )
    for column in ("score", "actions"):
        assert rows[column][[0, 2]].tolist() == plain[column][[0, 2]].tolist()


class Forgetful(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Does not pass the seed on."""

    def reset(self, **_: Any) -> Any:
        return super().reset()


class Stuck(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Passes another seed on."""

    def reset(self, **_: Any) -> Any:
        return super().reset(seed=0)


class Counting(gymnasium.ObservationWrapper[Any, Any, Any]):
    """Adds the number of observations that it has seen, in all episodes, to each of them."""

    seen = 0

    def observation(self, observation: Any) -> Any:
        self.seen += 1
        return observation + self.seen


def test_a_wrapper_keeps_no_state_of_earlier_episodes() -> None:
    """Actions that depend on it are those of an evaluation that begins with the second scene."""

    def parity(observation: Any) -> int:
        return int(np.sum(observation)) % 18

    where = {"tasks": "MoveToRegion", "variants": "Jitter", "preset": "State", "jobs": 1}
    both = magical_mj.evaluate(parity, episodes=2, wrap=f"{__name__}:Counting", **where)
    second = magical_mj.evaluate(parity, episodes=1, first_seed=1, wrap=f"{__name__}:Counting", **where)
    assert both["actions"][1] == second["actions"][0]


@pytest.mark.parametrize("wrapper", [Forgetful, Stuck])
def test_a_wrapper_must_pass_the_seed_on(wrapper: type[gymnasium.Wrapper[Any, Any, Any, Any]]) -> None:
    """Otherwise the episodes of all seeds would be of other scenes than recorded."""
    problem = r"a wrapper did not pass the seed .* on, so that the episode started in another scene"
    with pytest.raises(EvaluationError, match=problem):
        evaluate(lambda _: 0, variants="Jitter", wrap=f"{__name__}:{wrapper.__name__}", **STATE)
    one = wrapper(gymnasium.make("magical_mj/MoveToRegion-TestJitter-State-v0"))
    several = SyncVectorEnv([lambda: wrapper(gymnasium.make("magical_mj/MoveToRegion-TestJitter-State-v0"))] * 2)
    for env in (one, several):
        with pytest.raises(EvaluationError, match=problem):
            list(rollouts(env, lambda _: 0, [Episode("MoveToRegion", "Jitter", seed) for seed in range(2)]))
