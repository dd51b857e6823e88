"""The examples in docstrings run, and print what they say."""

from __future__ import annotations

import doctest
from importlib import import_module

import pytest

import magical_mj

MODULES = (
    "engine.engine",
    "envs.gymnasium_env",
    "envs.composer.environment",
    "envs.vector",
    "evaluation.run",
    "wrappers",
)


@pytest.mark.parametrize("module", MODULES)
def test_examples_in_docstrings_run(module: str) -> None:
    names = {"magical_mj": magical_mj, "Robot": magical_mj.Robot, "Block": magical_mj.Block}
    result = doctest.testmod(import_module(f"magical_mj.{module}"), extraglobs=names)
    assert (result.failed, result.attempted > 0) == (0, True)
