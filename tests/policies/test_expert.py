"""The experts: how they drive, and that they solve what they promise."""

from __future__ import annotations

import dataclasses
import math
from contextlib import closing

import gymnasium
import numpy as np
import pytest

import magical_mj
from magical_mj import TASKS, Block, Robot, Scene
from magical_mj.actions import NOOP, Action, Drive, Gripper, Turn
from magical_mj.experts import Expert, GoalPicture
from magical_mj.experts.driving import HumanExecution, Lookahead, drive, steer
from magical_mj.experts.grid import CELL
from magical_mj.experts.manoeuvres import manoeuvres, obstacles, simplified
from magical_mj.experts.navigation import EMPTY, SearchTree, cell_costs, cells, explore, farthest
from magical_mj.scene.bodies import BODIES
from magical_mj.tasks import move_to_region
from magical_mj.tasks.planning import Noise, Subgoal
from magical_mj.tasks.registry import SPLITS
from magical_mj.utils.errors import InvalidSceneError, InvalidSeedError, PlacementError, SettingsError, UnknownNameError


def noise(seed: int = 0, strength: float = 1.0) -> Noise:
    return Noise(np.random.default_rng(seed), strength)


def played(env: magical_mj.Engine, task: str, scene_seed: int, seed: int = 0) -> float:
    """The score of an expert's episode."""
    env.reset(seed=scene_seed)
    expert = Expert(env, task, seed)
    while not env.step(expert()):
        pass
    return env.score()


def env_of(task: str, variant: str = "Demo", seed: int = 0) -> magical_mj.Engine:
    env = magical_mj.Engine(task, variant, seed=seed)
    env.reset(seed=seed)
    return env


def _cramped(initial: Scene, now: Scene, noise: Noise) -> list[Subgoal]:
    if noise.strength == 1.0:  # the first attempt of three
        raise PlacementError("a plan has no position for the robot")
    return move_to_region.plan(initial, now, noise)


CRAMPED = dataclasses.replace(move_to_region.SPEC, name="Cramped", plan=_cramped)


def test_a_plan_without_a_position_ends_the_attempt_and_not_the_episode() -> None:
    task = "tests.policies.test_expert:CRAMPED"
    assert played(env_of(task), task, 0) == 1.0


# paths


def test_paths_can_be_driven_by_the_robot() -> None:
    scene = magical_mj.sample_scene("FindDupe", "Demo", 0)
    costs = cell_costs(obstacles(scene), EMPTY)
    tree = explore(scene.robot.pose, costs, 60)
    assert np.array_equal(tree.poses[0], scene.robot.pose)
    assert len(tree.poses) > 5000
    assert (costs[cells(tree.poses[1:])] >= 0).all()
    node = int(tree.steps.argmax())
    path = np.array(tree.path_to(node))
    assert np.array_equal(path[-1], tree.poses[node])
    assert np.hypot(*np.diff(path[:, :2], axis=0).T).max() <= 0.1 + 1e-9
    assert np.abs(np.diff(path[:, 2])).max() <= 0.3125 + 1e-9


def test_blocks_cost_toll_and_walls_stop() -> None:
    costs = cell_costs(np.array([[0.0, 0.0, 0.12]]), EMPTY)
    inside, free, wall = cells(np.array([[0.0, -0.25, 0.0], [0.6, -0.5, 0.0], [0.0, 0.9, 0.0]]))
    assert costs[free] == 0
    assert costs[inside] != 0
    assert costs[wall] < 0
    assert max(y + radius for _, y, radius in EMPTY) < 0.38


def test_routes_are_driven() -> None:
    """Of paths to anywhere in an empty arena only a few points are left, and the robot gets there."""
    env = env_of("MoveToRegion")
    world = Lookahead(env)
    costs = cell_costs(np.empty((0, 3)), EMPTY)
    tree = explore(world.robot, costs, 50)
    start = world.state
    for node in np.random.default_rng(0).integers(len(tree.poses), size=12).tolist():
        world.restore(start)
        route = simplified(tree.path_to(node), costs)
        assert len(route) <= 3
        assert drive(world, route, Gripper.OPEN, 80, within=0.1)
        for _ in range(4):
            world.act(Gripper.OPEN)  # it comes to rest
        assert math.dist(world.robot[:2], tree.poses[node][:2]) < 0.22


def test_a_straight_line_ends_in_the_cell_of_its_last_pose() -> None:
    """Also if the pose is on the border of a cell, where rounding could lead into the next one."""
    rng, free = np.random.default_rng(0), cell_costs(np.empty((0, 3)), EMPTY)
    for start, end in zip(rng.uniform(-0.8, 0.8, (100, 2)), CELL * rng.integers(-16, 17, (100, 2)), strict=True):
        (dx, dy), costs = end - start, np.full_like(free, -1)
        line = np.linspace(start, end, max(2, math.ceil(math.hypot(dx, dy) / CELL)))
        costs[cells(np.column_stack([line, np.full(len(line), math.atan2(-dx, dy))]))] = 0
        assert farthest([(*start, 0.0), (*end, 0.0)], 0, costs) == 1


def test_a_route_goes_round_a_block() -> None:
    env = magical_mj.Engine.of_scene(Scene(Robot(0, -0.7, 0), (Block("circle", "red", 0, 0, 0),)))
    env.reset()
    world = Lookahead(env)
    costs = cell_costs(obstacles(env.scene), EMPTY)
    tree = explore(world.robot, costs, 80)
    node = int(np.hypot(*(tree.poses[:, :2] - (0.0, 0.7)).T).argmin())
    assert drive(world, simplified(tree.path_to(node), costs), Gripper.OPEN, 80, within=0.1)
    assert world.robot[1] > 0.5
    assert math.dist(world.block(0), (0, 0)) < 0.05


@pytest.mark.parametrize(
    ("point", "turn", "motion"),
    [
        ((0.0, 0.8), Turn.NONE, Drive.FORWARD),
        ((0.3, 0.8), Turn.RIGHT, Drive.FORWARD),
        ((-0.8, 0.2), Turn.LEFT, Drive.NONE),
        ((0.0, -0.2), Turn.NONE, Drive.BACK),
    ],
)
def test_steering_depends_on_where_the_point_is(point: tuple[float, float], turn: Turn, motion: Drive) -> None:
    env = magical_mj.Engine.of_scene(Scene(Robot(0, 0, 0)))
    env.reset()
    assert steer(Lookahead(env), point, 0.0, Gripper.OPEN, reverse=False) == (Gripper.OPEN, turn, motion)


def test_a_person_is_late_now_and_then() -> None:
    execution = HumanExecution(np.random.default_rng(0))
    ahead, back = Action(drive=Drive.FORWARD), Action(drive=Drive.BACK)
    assert execution(None, back) == back
    done = [execution(ahead, back) for _ in range(400)]
    assert 70 < done.count(ahead) < 130
    assert done.count(ahead) + done.count(back) == 400
    assert {execution.pause() for _ in range(50)} == {0, 1, 2, 3}


# lookahead


def test_the_lookahead_predicts_the_simulation() -> None:
    env = env_of("ClusterColour", "All", 3)
    world = Lookahead(env)
    rng = np.random.default_rng(0)
    for _ in range(60):
        gripper, turn, drive = Gripper(rng.integers(2)), Turn(rng.integers(3)), Drive(rng.integers(3))
        world.act(gripper, turn, drive)
        env.step(world.trace[-1])
        assert np.array_equal(world.state.simulation, env.save())
    assert world.scene() == env.scene


def test_a_restored_lookahead_predicts_the_simulation() -> None:
    """To the bit, though some blocks sleep at that moment, others push one another, and some actions were tried."""
    env = env_of("ClusterColour", "All", 3)
    for _ in range(20):
        env.step(Action(Gripper.CLOSE, Turn.NONE, Drive.FORWARD).number)
    world = Lookahead(env)
    asleep = env.data.tree_asleep >= 0
    assert asleep.any()
    assert not asleep.all()
    here = world.state
    for number in range(35):
        world.act(
            *((Gripper.CLOSE, Turn.RIGHT, Drive.FORWARD) if number < 10 else (Gripper.OPEN, Turn.LEFT, Drive.BACK))
        )
    world.restore(here)
    for _ in range(40):
        world.act(Gripper.CLOSE, Turn.RIGHT, Drive.FORWARD)
        env.step(world.trace[-1])
        assert np.array_equal(world.state.simulation, env.save())


def test_lookahead_leaves_the_environment_alone() -> None:
    env = env_of("FindDupe")
    before = env.save()
    Expert(env, "FindDupe")()
    assert np.array_equal(before, env.save())


# experts


@pytest.mark.parametrize("task", TASKS)
def test_experts_solve_every_task(task: str) -> None:
    """docs/experts.md counts 20 episodes in each of all environments."""
    assert played(env_of(task, "All"), task, scene_seed=0) == 1.0


def test_the_same_seed_does_the_same_and_another_something_else() -> None:
    env = env_of("FixColour")

    def acted(seed: int) -> list[int]:
        env.reset(seed=0)
        expert = Expert(env, "FixColour", seed)
        taken = [expert()]
        while not env.step(taken[-1]):
            taken.append(expert())
        return taken

    first = acted(0)
    assert acted(0) == first
    assert acted(1) != first


def test_it_plans_again_when_the_world_is_not_as_foreseen() -> None:
    env = env_of("MoveToCorner")
    expert = Expert(env, "MoveToCorner")
    for step in range(80):
        action = expert()
        env.step(NOOP if 5 <= step < 10 else action)  # somebody holds the robot for a while
    assert env.score() == 1.0


@pytest.mark.parametrize("shifts", ["latency:4", "latency:5,slip:5"])
def test_it_foresees_what_becomes_of_its_actions(shifts: str) -> None:
    """Also with actions on their way: one plan holds to the end, and solves the task."""
    with closing(magical_mj.Engine("MoveToRegion", seed=1, shifts=shifts)) as env:
        for action in range(6):
            env.step(action)
        expert = Expert(env, "MoveToRegion")
        action, plan = expert(), expert._plan
        while not env.step(action):
            action = expert()
        assert env.score() == 1.0
        assert expert._plan is plan


def test_it_follows_the_environment_into_new_scenes() -> None:
    env = env_of("FindDupe", "All", 0)
    expert = Expert(env, "FindDupe")
    for seed in (0, 1):
        env.reset(seed=seed)
        while not env.step(expert()):
            pass
        assert env.score() == 1.0
    assert expert() == NOOP  # the episode is over


def test_wrong_tasks_and_scenes_are_refused() -> None:
    env = env_of("MakeLine")
    with pytest.raises(UnknownNameError):
        Expert(env, "MakeLines")
    with pytest.raises(InvalidSceneError):
        Expert(env, "FindDupe")
    for seed in (-1, 0.5, "1", None):
        with pytest.raises(InvalidSeedError):
            Expert(env, "MakeLine", seed)


def test_a_hopeless_scene_is_played_to_its_end() -> None:
    """A block between the robot and a corner of the arena where no finger can reach behind it."""
    scene = magical_mj.sample_scene("MoveToCorner", "Demo", 0)
    corner = dataclasses.replace(scene, blocks=(Block("square", "red", 0.89, -0.89, 0.0),), robot=Robot(0.0, 0.0, 0.0))
    env = magical_mj.Engine("MoveToCorner", scene=corner)
    env.reset()
    for _ in range(72):
        env.step(NOOP)
    expert = Expert(env, "MoveToCorner")
    for _ in range(8):
        last = env.step(expert())
    assert last
    assert env.score() == 0.0


def test_it_plans_by_the_rules_of_its_environment() -> None:
    """By the paper's rules, it would be content with an end that is not by the released code's."""
    env = magical_mj.Engine("ClusterShape", "All", rules="released", seed=2)
    assert played(env, "ClusterShape", 2, 2) == 1.0


def test_plain_scenes_have_no_expert() -> None:
    env = magical_mj.Engine.of_scene(Scene(Robot(0, 0, 0)))
    env.reset()
    with pytest.raises(InvalidSceneError):
        Expert(env, "FindDupe")


def test_an_expert_drives_an_engine() -> None:
    with pytest.raises(SettingsError, match=r"env\.unwrapped\.engine"):
        Expert(magical_mj.MagicalEnv("MoveToRegion"), "MoveToRegion")


@pytest.mark.parametrize("body", ["shortstick", "mediumstick"])
def test_sticks_push_what_they_cannot_get_behind(body: str) -> None:
    """In MoveToCorner the block lies near a wall, and goes to its corner by another one."""
    for seed in (1, 3):
        with closing(magical_mj.Engine("MoveToCorner", "All", seed=SPLITS["dev"] + seed, body=body)) as engine:
            expert = Expert(engine, "MoveToCorner", 0)
            while not engine.step(expert()):
                pass
            assert engine.score() == 1.0


def test_a_position_out_of_reach_is_approached() -> None:
    """As after random actions, when the paths that the robot can see end before the place."""
    tree = SearchTree(np.array([(0.0, 0.0, 0.0), (0.0, 0.1, 0.0)]), np.array([-1, 0]), np.array([0, 1]))
    scene = magical_mj.sample_scene("MoveToRegion", "Demo", 0)
    free, noise = cell_costs(obstacles(scene), EMPTY), Noise(np.random.default_rng(0), 1.0)
    (manoeuvre,) = manoeuvres(tree, free, scene, Subgoal(None, (0.5, 0.5), 0.1), noise, BODIES["gripper"])
    assert manoeuvre.route[-1] == (0.5, 0.5)
    assert manoeuvre.estimate == 1.0


def test_goals_are_pictures_of_the_solved_scene() -> None:
    env = GoalPicture(gymnasium.make("magical_mj/FindDupe-TestAll-State-v0"), size=64)
    _, info = env.reset(seed=3)
    *_, after = env.step(0)
    assert after["goal"] is info["goal"]
    engine = env_of("FindDupe", "All", 3)
    assert played(engine, "FindDupe", 3) == 1.0
    assert np.array_equal(info["goal"], engine.render("allo", 64))
    assert not np.array_equal(env.reset(seed=4)[1]["goal"], info["goal"])
    with pytest.raises(SettingsError, match="whose task has a plan"):
        GoalPicture(gymnasium.make("CartPole-v1"))
