"""Questions as files: JSON lines with pictures, and a description by Croissant (https://docs.mlcommons.org/croissant).

A folder has questions.jsonl, whose lines are questions with their prompts, images/, and croissant.json. Hugging
Face's datasets reads the lines, and mlcroissant reads them by the description.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Final

import magical_mj
from magical_mj.intents.question import Question
from magical_mj.intents.question_pictures import png
from magical_mj.intents.question_text import prompt, table
from magical_mj.utils import files
from magical_mj.utils.errors import SettingsError

FILE, DESCRIPTION, IMAGES = "questions.jsonl", "croissant.json", "images"
FIELDS: Final = {
    "id": "The question's name.",
    "task": "choose, say, place or act.",
    "set": "The set of the intent.",
    "kind": "For choose: logic, where the demonstrations refute the other options' readings, or prior.",
    "prompt": "The question as text. Scenes are tables of poses.",
    "answer": "A right answer.",
    "readings": "For choose: the reading of each option, as JSON.",
    "intent": "The intent, in the language of intents.",
    "sentence": "The intent in English.",
    "images": "The pictures of the scenes in the order of the prompt, as JSON.",
    "question": "All scenes, as JSON; magical_mj.intents.question_of reads it.",
}
"""Field of a line -> its description. All are texts."""
CONTEXT: Final = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "sc": "https://schema.org/",
    "dct": "http://purl.org/dc/terms/",
    "conformsTo": "dct:conformsTo",
    "recordSet": "cr:recordSet",
    "field": "cr:field",
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "source": "cr:source",
    "extract": "cr:extract",
    "column": "cr:column",
    "jsonPath": "cr:jsonPath",
    "fileObject": "cr:fileObject",
}


def write(questions: Iterable[Question], folder: Path, name: str, watch: Callable[[int], None] = lambda _: None) -> int:
    """Writes questions into a new folder, and returns their number.

    Args:
        questions: the questions.
        folder: the folder, which must not exist, or be empty.
        name: the name of the data set.
        watch: called with the number of finished questions.

    Raises:
        SettingsError: if the folder contains files, or questions are missing.
    """
    if folder.exists() and any(folder.iterdir()):
        raise SettingsError(f"{folder} is not empty: give another folder, or delete it")
    (folder / IMAGES).mkdir(parents=True, exist_ok=True)
    lines = []
    for question in questions:
        lines.append(json.dumps(_line(question, folder)))
        watch(len(lines))
    if not lines:
        raise SettingsError("there is no question with these settings")
    text = "".join(f"{line}\n" for line in lines)
    files.write(folder / FILE, text)
    files.write(folder / DESCRIPTION, json.dumps(_description(name, text), indent=2) + "\n")
    return len(lines)


def _line(question: Question, folder: Path) -> dict[str, str]:
    texts, images = list[str](), list[str]()
    for part in prompt(question):
        if isinstance(part, str):
            texts.append(part)
            continue
        data = png(part)
        path = f"{IMAGES}/{hashlib.sha256(data).hexdigest()[:16]}.png"
        (folder / path).write_bytes(data)
        images.append(path)
        texts.append(table(part))
    values = {
        "id": question.id,
        "task": question.task,
        "set": question.set,
        "kind": question.kind,
        "prompt": "\n\n".join(texts),
        "answer": question.answer,
        "readings": json.dumps(question.readings),
        "intent": str(question.intent),
        "sentence": question.intent.sentence,
        "images": json.dumps(images),
        "question": json.dumps(question.data),
    }
    return {field: values[field] for field in FIELDS}


def _description(name: str, text: str) -> dict[str, Any]:
    fields = [
        {
            "@type": "cr:Field",
            "@id": f"questions/{field}",
            "name": field,
            "description": description,
            "dataType": "sc:Text",
            "source": {"fileObject": {"@id": FILE}, "extract": {"column": field}},
        }
        for field, description in FIELDS.items()
    ]
    return {
        "@context": CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": name,
        "description": "Questions about what demonstrations were for, made by magical_mj.",
        "version": magical_mj.__version__,
        "license": "https://www.apache.org/licenses/LICENSE-2.0",
        "distribution": [
            {
                "@type": "cr:FileObject",
                "@id": FILE,
                "name": FILE,
                "contentUrl": FILE,
                "encodingFormat": "application/jsonlines",
                "sha256": hashlib.sha256(text.encode()).hexdigest(),
            }
        ],
        "recordSet": [{"@type": "cr:RecordSet", "@id": "questions", "name": "questions", "field": fields}],
    }
