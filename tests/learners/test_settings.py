"""The learners' settings: the paper's numbers, TOML there and back, and what is refused."""

from __future__ import annotations

import tomllib
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from magical_mj import TASKS
from magical_mj.learners import load_settings
from magical_mj.learners.config import QUICK, as_toml, flattened, from_toml, to_toml
from magical_mj.learners.data import chosen
from magical_mj.learners.networks import Actor
from magical_mj.learners.settings import TrainingSettings
from magical_mj.utils.errors import SettingsError, UnknownNameError
from magical_mj.utils.settings import described, with_changes
from tests.helpers.learners import tiny


def test_defaults_are_the_papers() -> None:
    """Appendix, tables of hyperparameters for BC and GAIL."""
    settings = load_settings("gail", "FindDupe")
    assert (settings.bc.batches, settings.bc.batch_size, settings.bc.learning_rate, settings.bc.momentum) == (
        20_000, 32, 1e-3, 0.1
    )  # fmt: skip
    ppo = settings.ppo
    assert (ppo.environments, ppo.steps, ppo.epochs, ppo.minibatch, ppo.learning_rate) == (32, 8, 12, 64, 6e-5)
    assert (ppo.discount, ppo.gae_lambda, ppo.entropy, ppo.clip, ppo.gradient_norm) == (0.8, 0.8, 1e-5, 0.01, 1.0)
    assert (ppo.total_steps, ppo.reward_deviation) == (10**6, 0.1)
    judge = settings.discriminator
    assert (judge.steps, judge.batch_size, judge.learning_rate, judge.gradient_penalty) == (12, 24, 2.5e-5, 100)
    assert (settings.features.batches, settings.features.size, settings.features.samples) == (8192, 32, 512)
    assert len(chosen(settings, "FindDupe")) == 10


def test_quick_changes_only_the_settings_of_its_table() -> None:
    full, quick = load_settings("bc", "all"), load_settings("bc", "all", quick=True)
    assert quick == load_settings("bc", "all", **QUICK) != full
    assert quick.tasks == TASKS


@pytest.mark.parametrize("short", [{"quick": True}, {"preset": "State"}])
def test_al_learns_as_slowly_as_the_papers_in_short_trainings_too(short: dict[str, Any]) -> None:
    for name in ("ppo.learning_rate", "ppo.clip", "ppo.entropy"):
        paper, al, gail = (
            flattened(asdict(load_settings(method, "FindDupe", **given)))[name]
            for method, given in (("al", {}), ("al", short), ("gail", short))
        )
        assert al == paper != gail
    assert load_settings("al", "FindDupe", **short, **{"ppo.clip": 0.5}).ppo.clip == 0.5


@pytest.mark.parametrize(
    "settings",
    [
        load_settings("gail", TASKS[:8]),
        load_settings("al", "FindDupe,MakeLine", quick=True, seed=7, **{"ppo.clip": 0.02, "features.size": 5}),
        load_settings("bc", "FindDupe", preset="State", **{"bc.heads": "normal"}),
        TrainingSettings('odd "name" \\ é', ("MakeLine",)),
    ],
)
def test_toml_there_and_back(settings: TrainingSettings, tmp_path: Path) -> None:
    path = tmp_path / "config.toml"
    path.write_text(to_toml(settings))
    assert to_toml(from_toml(path)) == to_toml(settings)


def test_toml_contains_the_settings_that_the_method_uses() -> None:
    text = to_toml(TrainingSettings("a method of one's own", ("FindDupe",), demonstrations=10, renderer="software"))
    for name in described(TrainingSettings):
        assert f"{name.rpartition('.')[2]} = " in text
    assert "[bc]" in to_toml(tiny("bc"))
    assert "[ppo]" not in to_toml(tiny("bc"))
    assert "[bc]" not in to_toml(tiny("gail"))
    assert "[ppo]" in to_toml(tiny("gail"))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"seed": 2**63}, "seed"),
        ({"bc.optimizer": "adam", "bc.momentum": 0.5}, "bc.momentum"),
        ({"bc.final_learning_rate": 1}, "learning rates must not rise"),
        ({"network.first_kernel": 4}, "odd"),
        ({"network.entity": 62}, "multiple of 4"),
        ({"preset": "LoResCHW4E"}, "one stack of frames"),
        ({"preset": "LoRes5E"}, "LoRes4E"),
        ({"tasks": ("FindDupes",)}, "FindDupe"),
        ({"tasks": ("FindDupe", "FindDupe")}, "different"),
        ({"tasks": ()}, "tasks"),
        ({"tasks": ("FindDupe", "MakeLine", "FixColour")}, "ppo.environments"),
        ({"ppo.minibatch": 100}, "ppo.minibatch"),
        ({"ppo.total_steps": 100}, "ppo.total_steps"),
        ({"discriminator.batch_size": 25}, "discriminator.batch_size"),
        ({"features.samples": 1, "tasks": ("FindDupe", "MakeLine")}, "features.samples"),
    ],
)
def test_wrong_settings_are_refused(changes: dict[str, Any], says: str) -> None:
    with pytest.raises((SettingsError, UnknownNameError), match=says):
        with_changes(TrainingSettings, {"method": "gail", "tasks": ("FindDupe",), **changes})


def test_defaults_that_do_not_fit_the_tasks_can_be_changed() -> None:
    """The paper's 32 environments cannot be split between three tasks."""
    settings = load_settings("gail", "MoveToRegion,FixColour,FindDupe", **{"ppo.environments": 36, "ppo.minibatch": 72})
    assert (len(settings.tasks), settings.ppo.environments) == (3, 36)


@pytest.mark.parametrize(
    ("changes", "states"),
    [
        ({"network.hidden": 10**6}, False),
        ({"network.channels": 10**5}, False),
        ({"network.first_channels": 10**5, "network.channels": 1, "network.first_stride": 1}, False),
        ({"network.entity": 10**6}, True),
    ],
)
def test_networks_that_are_too_large_are_not_built(changes: dict[str, Any], states: bool) -> None:
    network = tiny(**changes).network
    with pytest.raises(SettingsError, match="at most 50,000,000"):
        Actor(network, 1, states=states)


def test_cloning_does_not_check_settings_of_ppo() -> None:
    assert tiny("bc", "FindDupe,MakeLine,FixColour", **{"ppo.minibatch": 100}).tasks == (
        "FindDupe", "MakeLine", "FixColour"
    )  # fmt: skip
    assert len(tiny("goals", "FindDupe,MakeLine,FixColour", preset="State").tasks) == 3


@pytest.mark.parametrize(
    "text",
    [
        "method = ",
        "seed = 3",
        "method = 'bc'\ntasks = ['Nope']",
        "method = 'bc'\ntasks = 3",
        "method = 3\ntasks = 'all'",
        "method = 'bc'\ntasks = 'all'\nmade = 3",
        "\xff",
        f"a = {'[' * 10_000}",
    ],
)
def test_files_without_valid_settings_are_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "config.toml"
    path.write_text(text, "latin-1")
    with pytest.raises((SettingsError, UnknownNameError)):
        from_toml(path)


@pytest.mark.parametrize("text", ["runs/bc-\U0001f389", 'a\x7f\n"b\\', "no UTF-8: \udcff", "Zürich"])
def test_any_text_is_written_as_toml(text: str) -> None:
    read = tomllib.loads(as_toml({"text": text}))["text"]
    assert read == text.encode(errors="backslashreplace").decode()


def test_quick_is_for_pictures() -> None:
    with pytest.raises(SettingsError, match="quick is for pictures"):
        load_settings("bc", "FindDupe", quick=True, preset="State")
