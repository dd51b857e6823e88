"""Names of methods that readers could not tell apart."""

from __future__ import annotations

import pytest

from magical_mj.leaderboard.names import appearance, check_method_name
from magical_mj.utils.errors import EvaluationError


@pytest.mark.parametrize(
    "name",
    ["bc", "BC (ours), \u03b1=0.5", "μ-BC", "Méthode naïve", "метод", "方法 BC", "方法BC", "ひらがなのBC", "한국어BC"],
)
def test_names_in_any_script_are_allowed(name: str) -> None:
    check_method_name(name, "an entry")


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        *((f"bc{letter}", "invisible") for letter in "\u200b\u00ad\u034f\u3164\ufe0f\u2800\u202e\n "),
        ("Me\u0301thode", "composed form"),
        ("r\u0435lational", "mixes the scripts Cyrillic and Latin"),
        ("\u03bfracle", "mixes the scripts Greek and Latin"),
    ],
)
def test_names_that_hide_what_they_consist_of_are_refused(name: str, problem: str) -> None:
    with pytest.raises(EvaluationError, match=problem):
        check_method_name(name, "an entry")


def test_names_that_read_the_same_are_equal() -> None:
    assert (
        appearance("copy")
        == appearance("Copy")
        == appearance("\u0441\u043e\u0440\u0443")
        == appearance("\uff23\uff2f\uff30\uff39")
    )
    names = ["bc-1", "bc-l", "метод", "方法", "方案", "Méthode", "Methode"]
    assert len(set(map(appearance, names))) == len(names)
