"""What `choose` gives to cues and to exact inference: `python -m tools.question_floors`, with scenes as arguments.

A cue answers without an understanding of the intent, such as by the option in which the most blocks have moved. Exact
inference knows the language: it gives each intent that all demonstrations allow a prior of 2 to the power of minus its
bits, and chooses the option in which the greatest share holds. Writes docs/question-floors.csv and the table of
docs/models.md.
"""

from __future__ import annotations

import argparse
import csv
from collections import defaultdict
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


def main() -> None:
    """Prints and writes the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", type=int, default=[1, 2, 4])
    parser.add_argument("--contrasting", action="store_true", help="contrasting demo scenes instead of random ones")
    parser.add_argument("--limit", type=int, help="the number of questions in each set; by default all")
    arguments = parser.parse_args()
    rows: list[dict[str, object]] = []
    for scenes in arguments.scenes:
        found: dict[str, list[dict[str, float]]] = defaultdict(list)
        contrasting = arguments.contrasting and scenes > 1
        for name in SETS:
            for question in questions("choose", name, scenes=scenes, contrasting=contrasting, limit=arguments.limit):
                found[question.kind].append(chances(question))
        for kind, values in found.items():
            means = {cue: round(float(np.mean([value[cue] for value in values])), 3) for cue in values[0]}
            row: dict[str, object] = {
                "scenes": scenes,
                "contrasting": contrasting,
                "kind": kind,
                "questions": len(values),
                **means,
            }
            print(", ".join(f"{name} {value}" for name, value in row.items()), flush=True)
            rows.append(row)
    with FILE.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    PAGE.write_text(filled(PAGE.read_text("utf-8"), {"floors": floors()}, COMMAND), "utf-8")


def floors() -> str:
    """The table of docs/models.md."""
    with FILE.open(newline="") as file:
        rows = list(csv.DictReader(file))
    columns = [f"{row['kind']}, {row['scenes']} scene{'s' * (row['scenes'] != '1')}" for row in rows]
    named = [name for name in rows[0] if name not in ("scenes", "contrasting", "kind", "questions")]
    lines = [[name[:1].upper() + name[1:], *(number(float(row[name])) for row in rows)] for name in named]
    return table(["Answers by", *columns], [*lines, ["Questions", *(row["questions"] for row in rows)]])


if __name__ == "__main__":
    main()
