"""Names of methods, which readers must be able to tell apart: the leaderboard shows them in one list."""

from __future__ import annotations

import re
import unicodedata
from typing import Final

from magical_mj.utils.errors import EvaluationError
from magical_mj.utils.extras import check_module

_IGNORABLE: Final = re.compile("[\u00ad\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180f\u2800\u3164\ufe00-\ufe0f\uffa0]")
"""Characters without a shape that Python counts as printable: default ignorables, and the blank of Braille."""
_TOGETHER: Final = (
    frozenset({"LATIN", "HAN", "HIRAGANA", "KATAKANA", "BOPOMOFO"}),
    frozenset({"LATIN", "HAN", "HANGUL"}),
)
"""The scripts that may occur in one word: Unicode's "highly restrictive" level (UTS 39)."""


def check_method_name(method: str, where: object) -> None:
    """Raises an `EvaluationError` if readers could not see what a method's name consists of.

    The name must be in Unicode's composed form (NFC), without invisible characters, and its words in one script each.
    """
    problem = _problem(method)
    if problem:
        raise EvaluationError(f"the method's name {method!a} in {where} {problem}")


def _problem(method: str) -> str:
    if not method.isprintable() or method != method.strip() or _IGNORABLE.search(method):
        return "has invisible characters, or begins or ends with a space"
    if not unicodedata.is_normalized("NFC", method):
        return "is not in Unicode's composed form (NFC), so that it looks like another name"
    if method.isascii():
        return ""
    check_module("names in other letters", "confusable_homoglyphs", "eval")
    from confusable_homoglyphs import categories

    for word in re.findall(r"[^\W\d_]+", method):
        scripts = categories.unique_aliases(word) - {"COMMON", "INHERITED"}
        if len(scripts) > 1 and not any(scripts <= allowed for allowed in _TOGETHER):
            return f"mixes the scripts {' and '.join(sorted(map(str.title, scripts)))} in one word"
    return ""


def appearance(method: str) -> str:
    """A key that is the same for names that readers cannot tell apart, such as in Latin and in Cyrillic letters."""
    if method.isascii():
        return method.casefold()
    check_module("names in other letters", "confusable_homoglyphs", "eval")
    from confusable_homoglyphs import confusables

    method = unicodedata.normalize("NFKC", method)
    alike = {found["character"]: found["homoglyphs"] for found in confusables.is_confusable(method, greedy=True) or ()}
    latin = {
        letter: min((other["c"] for other in others if other["c"].isascii()), default=letter, key=len)
        for letter, others in alike.items()
        if not letter.isascii()
    }
    return "".join(latin.get(letter, letter) for letter in method).casefold()
