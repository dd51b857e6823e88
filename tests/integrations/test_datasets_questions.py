"""Hugging Face datasets and mlcroissant load the questions that `magical-mj demos questions` writes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from magical_mj.intents import question_of, questions
from magical_mj.intents.question_files import write

pytest.importorskip("datasets", reason="datasets is missing: make integrations-test LIBRARY=datasets")

import datasets
import mlcroissant

pytestmark = pytest.mark.filterwarnings("default")  # the library's own are not ours to mend


def test_questions_are_loaded_with_their_pictures(tmp_path: Path) -> None:
    made = list(questions("choose", "combined", scenes=1, limit=2))
    write(made, tmp_path / "out", "questions")
    lines = str(tmp_path / "out" / "questions.jsonl")
    loaded = datasets.load_dataset("json", data_files=lines, split="train", cache_dir=str(tmp_path / "cache"))
    described = mlcroissant.Dataset(jsonld=str(tmp_path / "out" / "croissant.json"))
    rows = described.records("questions")
    records = [{name.partition("/")[2]: text.decode() for name, text in row.items()} for row in rows]
    assert records == list(loaded)
    assert [question_of(json.loads(row["question"])) for row in loaded] == made
    pictures = [str(tmp_path / "out" / name) for name in json.loads(loaded[0]["images"])]
    shown = datasets.Dataset.from_dict({"picture": pictures}).cast_column("picture", datasets.Image())
    assert {picture["picture"].size for picture in shown} == {(256, 256)}
