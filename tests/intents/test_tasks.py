"""Intents as tasks: their names, demo scenes, variants and plans."""

from __future__ import annotations

import itertools
import math

import pytest

import magical_mj
from magical_mj.engine import Engine
from magical_mj.experts import Expert
from magical_mj.intents import Intent, parse, rivals
from magical_mj.intents.contrast import refutes, simplest_rivals
from magical_mj.intents.plans import solved
from magical_mj.intents.scenes import accepts
from magical_mj.scene import Scene
from magical_mj.tasks.registry import code_digest, environments, sample_scene, task_name, task_spec
from magical_mj.utils.errors import IntentError, UnknownNameError

NAME = "intent:in(colour=red, region)"


def test_an_intent_is_a_task_in_load() -> None:
    with magical_mj.load(NAME, "Layout", seed=0, observations=("state",)) as env:
        env.reset()
        assert env.initial_scene == sample_scene(NAME, "Layout", 0)
        assert env.score() == 0.0


def test_a_subclass_that_may_mean_something_else_has_no_task() -> None:
    class Reversed(Intent):
        def score(self, initial: Scene, final: Scene) -> float:
            return 1.0 - super().score(initial, final)

    with pytest.raises(IntentError, match="Reversed may mean something else: make a TaskSpec"):
        Reversed(parse("line(all)").conjuncts).spec()


def test_every_spelling_of_an_intent_is_the_same_task() -> None:
    spelt = "intent:  untouched( others ) &in(colour = red,region) [seed=0, demos=1]"
    assert task_name(spelt) == "intent:in(colour=red, region) & untouched(others)"
    assert task_spec(spelt) is task_spec(task_name(spelt)) is parse(task_name(spelt)[7:]).spec()
    assert sample_scene(spelt, "All", 3) == sample_scene(task_name(spelt), "All", 3)
    assert environments(f"{spelt},FindDupe", "All") == [(task_name(spelt), "All"), ("FindDupe", "All")]


def test_two_intents_have_different_digests_and_names() -> None:
    others = [NAME, f"{NAME} [seed=1]", f"{NAME} [demos=2]", "intent:in(colour=blue, region)"]
    assert len({code_digest(name) for name in others}) == 4
    assert len({task_spec(name).name for name in others}) == 3  # test scenes do not depend on the number of demo scenes
    assert sample_scene(others[2], "Layout", 0) == sample_scene(NAME, "Layout", 0)
    assert [sample_scene(others[2], "Demo", seed) for seed in range(3)] == [
        *(demos := task_spec(others[2]).demos),
        demos[0],
    ]


@pytest.mark.parametrize(
    "wrong", ["in(colour=pink, region)", "in(colour=red, region) [demos=9]", "in(colour=red, region) [x]", "nothing"]
)
def test_texts_that_are_not_tasks_are_errors(wrong: str) -> None:
    with pytest.raises(IntentError):
        task_spec(f"intent:{wrong}")


def test_an_intent_that_no_scene_satisfies_says_why() -> None:
    with pytest.raises(IntentError, match="no plan satisfies it"):
        task_spec("intent:wall(colour=red, left) & wall(colour=red, right)")


@pytest.mark.parametrize(
    "text",
    [
        "in(colour=red, region)",
        "exactly(2, colour=blue)",
        "near(colour=red, to=blue star) & robot near(to=blue star)",
        "corner(any, all, top left) & wall(shape=star, any)",
        "apart(all)",
        "line(shape!=star)",
        "clustered(all, by=colour)",
        "in(any, like=both, region) & out(like!=both)",
        "out(starts=mismatched)",
        "wall(nearest=robot, top) & untouched(others)",
    ],
)
def test_scenes_of_all_variants_are_unsatisfied_and_solvable_and_an_expert_solves_them(text: str) -> None:
    intent = parse(text)
    spec = intent.spec()
    assert tuple(spec.variants) == (*magical_mj.VARIANTS, "Diagnose")
    for variant in magical_mj.VARIANTS:
        scene = sample_scene(f"intent:{text}", variant, 0)
        assert accepts(intent, scene), variant
        assert not intent.holds(scene, scene), variant
    engine = Engine(f"intent:{text}", "Layout", seed=0)
    expert = Expert(engine, f"intent:{text}")
    while not engine.step(expert()):
        pass
    assert engine.score() == 1.0


def test_contrasting_demo_scenes_refute_more_rivals_than_others() -> None:
    intent = parse("wall(shape=star, left)")
    left = []
    for contrasting in (False, True):
        spec = intent.spec(demos=4, contrasting=contrasting)
        assert spec.demo == intent.spec().demo
        assert spec.steps == intent.spec().steps
        found = rivals([(demo, solved(intent, demo) or demo) for demo in spec.demos], 20)
        assert intent in found
        left.append(len(found))
    assert left[1] < left[0] / 3


def test_scenes_of_diagnose_refute_the_simplest_rivals() -> None:
    """In each scene, a plan of one of the rivals satisfies the rival and not the intent; a plan of the intent does."""
    intent = parse("in(colour=red, region)")
    name, spec = f"intent:{intent}", intent.spec()
    simplest = simplest_rivals(intent, spec.demo)
    assert len(simplest) == 10
    assert set(simplest) <= set(rivals([(spec.demo, solved(intent, spec.demo) or spec.demo)]))
    scenes = [sample_scene(name, "Diagnose", seed) for seed in range(30)]
    refuted = [[refutes(intent, rival, scene) for rival in simplest] for scene in scenes]
    assert all(flags[seed % 10] for seed, flags in enumerate(refuted))
    assert all(accepts(intent, scene) for scene in scenes)
    alone = sample_scene("intent:robot in()", "Diagnose", 0)  # without rivals
    assert accepts(parse("robot in()"), alone)
    assert environments(name, "Diagnose,All") == [(name, "Diagnose"), (name, "All")]
    assert "Diagnose" not in dict(environments(name)).values()
    with pytest.raises(UnknownNameError, match="which only intents have"):
        sample_scene("FindDupe", "Diagnose", 0)


def test_colours_and_shapes_vary_where_the_sentence_keeps_its_meaning() -> None:
    intent = parse("near(colour=red, shape=star, to=blue circle)")
    demo = intent.spec().demo
    for variant, attribute in (("Colour", "colour"), ("Shape", "shape")):
        scenes = [sample_scene(f"intent:{intent}", variant, seed) for seed in range(10)]
        kinds = {tuple(getattr(block, attribute) for block in scene.blocks) for scene in scenes}
        assert len(kinds) > 1
        for scene in scenes:
            assert [block.pose for block in scene.blocks] == [block.pose for block in demo.blocks]
            words = [(block.colour, block.shape) for block in scene.blocks]
            assert ("red", "star") in words
            assert words.count(("blue", "circle")) == 1


def test_random_rivals_of_an_intent_have_plans_that_satisfy_them() -> None:
    """All kinds of relations and selectors: the plan's end satisfies the intent, and moves no block onto another."""
    for text in (
        "in(starts=matched, home) & out(starts=mismatched)",
        "wall(any, starts=out, bottom) & robot wall(top)",
        "near(farthest=region, to=pentagon) & untouched(others)",
        "exactly(1, like!=colour) & corner(odd=shape, any)",
        "line(colour=region) & out(all)",
    ):
        intent = parse(text)
        for seed in range(3):
            start = sample_scene(f"intent:{text}", "All", seed)
            end = solved(intent, start)
            assert end is not None
            assert intent.holds(start, end)
            centres = [(block.x, block.y) for block in end.blocks]
            assert min(math.dist(*pair) for pair in itertools.combinations(centres, 2)) > 0.2


def test_one_demo_scene_cannot_be_contrasting_and_tasks_with_more_have_ids_of_their_own() -> None:
    with pytest.raises(IntentError, match="for several demo scenes"):
        parse("robot in()").spec(contrasting=True)
    names = ["intent:robot in()", "intent:robot in() [demos=2]", "intent:robot in() [demos=2, contrasting]"]
    ids = [magical_mj.env_id(name, "Layout", "State") for name in names]
    assert len(set(ids)) == 3
    assert len({sample_scene(name, "Layout", 3) for name in names}) == 1
