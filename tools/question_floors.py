"""What `choose` gives to cues and to exact inference: `python -m tools.question_floors`, with scenes as arguments.

    python -m tools.question_floors 1 2 4 8 --limit 25
    python -m tools.question_floors 2 4 8 --contrasting --limit 25

A cue answers without an understanding of the intent, such as by the option with the most moved blocks. Exact
inference knows the language: it gives each intent that all demonstrations allow a prior of 2 to the power of minus its
bits, and chooses the option that fulfils the greatest share. Replaces
the rows of these settings in docs/question-floors.csv, and the table of docs/models.md.
"""

from __future__ import annotations

import argparse
import csv
from collections import defaultdict
from collections.abc import Iterator
from typing import Final

import numpy as np

from magical_mj.intents.ambiguity import Judge
from magical_mj.intents.choices import allowed_readings, weights
from magical_mj.intents.cues import CUES, by_words, preferences, success
from magical_mj.intents.question import LETTERS, Question, questions
from tools.pages import ROOT, filled, number, table

FILE: Final = ROOT / "docs" / "question-floors.csv"
PAGE: Final = ROOT / "docs" / "models.md"
COMMAND: Final = "python -m tools.question_floors"
SETS: Final = ("seen", "combined", "selector", "relation", "long")
INFERENCE: Final = "exact inference"
SHOWN: Final = ("most moved", "same ends", "same place", "nearest", "words of the sentence", INFERENCE)
"""The columns of the page."""
SETTINGS: Final = ("kind", "scenes", "demo scenes")
Row = dict[str, str]


def chances(question: Question) -> dict[str, float]:
    """The probability that each cue, and inference, choose the right option."""
    right = LETTERS.index(question.answer)
    ends = [question.options[right], *(end for place, end in enumerate(question.options) if place != right)]
    found = {cue: float(success(preferences(cue, question.watched, question.scene, ends))) for cue in CUES}
    allowed = allowed_readings(question.watched)
    judge = Judge(allowed)
    mass = np.array([weights(allowed) @ judge.reached(question.scene, end) for end in ends])
    words = float(success(by_words(question.intent.sentence, question.scene, ends)))
    return found | {"words of the sentence": words, INFERENCE: float(success(mass))}


def measured(scenes: int, *, contrasting: bool, limit: int | None) -> Iterator[Row]:
    """The rows of a setting, one for each kind of question."""
    found: dict[str, list[dict[str, float]]] = defaultdict(list)
    for name in SETS:
        for question in questions("choose", name, scenes=scenes, contrasting=contrasting, limit=limit):
            found[question.kind].append(chances(question))
    for kind, values in found.items():
        setting = {"kind": kind, "scenes": str(scenes), "demo scenes": "contrasting" if contrasting else "random"}
        means = {cue: f"{np.mean([value[cue] for value in values]):.3f}" for cue in values[0]}
        yield setting | {"questions": str(len(values))} | means


def main() -> None:
    """Measures settings, and writes their rows and the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="+", type=int)
    parser.add_argument("--contrasting", action="store_true", help="contrasting demo scenes instead of random ones")
    parser.add_argument("--limit", type=int, help="the number of questions in each set; by default all")
    arguments = parser.parse_args()
    for scenes in arguments.scenes:
        new = measured(scenes, contrasting=arguments.contrasting, limit=arguments.limit)
        known = {tuple(row[name] for name in SETTINGS): row for row in [*rows(), *new]}
        write([known[key] for key in sorted(known)])
    PAGE.write_text(filled(PAGE.read_text("utf-8"), {"floors": floors()}, COMMAND), "utf-8")


def rows() -> list[Row]:
    """The rows of the file."""
    with FILE.open(newline="") as file:
        return list(csv.DictReader(file))


def write(found: list[Row]) -> None:
    """Writes the file."""
    with FILE.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(found[0]))
        writer.writeheader()
        writer.writerows(found)


def floors() -> str:
    """The table of docs/models.md."""
    lines = [
        [
            f"{row['kind']}, {row['scenes']}{' contrasting' if row['demo scenes'] == 'contrasting' else ''}",
            row["questions"],
            *(number(float(row[name])) for name in SHOWN),
        ]
        for row in rows()
    ]
    return table(["Kind, demo scenes", "Questions", *(name[:1].upper() + name[1:] for name in SHOWN)], lines)


if __name__ == "__main__":
    main()
