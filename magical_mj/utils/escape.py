r"""Untrusted text, such as names and errors from other people's files, in this package's output formats.

There is one function for each format. All of them replace control characters, and characters that change the writing
direction, by their escapes, such as ``\x1b``. Such characters do not belong in names, and change the output of
terminals and browsers.
"""

from __future__ import annotations

import html as _html
import re
from typing import Final

_CONTROL: Final = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
"""All control characters except tabs and line ends. Surrogates are included, since they cannot be encoded."""

_MARKDOWN: Final = re.compile(
    r"""
    \\(?=[!-/:-@\[-`{-~]|$)  # backslashes that escape a character
    | [*`|~<>]
    | (?<![^\W_])_ | _(?![^\W_])  # inside a word, underscores have no meaning
    | \](?=[(\[:])  # links
    | ^(?:\#{1,6}|[-+])(?=\s|$)  # headings and lists
    | &(?=\#?\w+;)  # entities
    """,
    re.VERBOSE,
)


def terminal(text: str) -> str:
    """The text for a terminal, without escape sequences."""
    return _CONTROL.sub(lambda match: match[0].encode("unicode_escape").decode(), text)


def html(text: object) -> str:
    """A value's text for HTML, in elements and in quoted attributes."""
    return _html.escape(terminal(str(text)))


def markdown(text: str) -> str:
    """The text in one line of Markdown (CommonMark, and GitHub's): in a paragraph, an item of a list, or a table."""
    line = _MARKDOWN.sub(r"\\\g<0>", " ".join(terminal(text).split()))
    return re.sub(r"^\d{1,9}(?=[.)](\s|$))", r"\g<0>\\", line)  # the first number of a list


def markdown_code(text: str) -> str:
    """The text as code in Markdown. If it has characters other than letters, digits and ``.-_``, it is plain text."""
    return f"`{text}`" if re.fullmatch(r"[\w.-]+", text) else markdown(text)


def markdown_link(text: str, target: str) -> str:
    """A link in Markdown to a target that is already quoted."""
    inside = re.sub(r"(\\.)|([\[\]])", lambda match: match[1] or f"\\{match[2]}", markdown(text))
    return f"[{inside}]({target})"


def csv(text: str) -> str:
    """The text as a cell of CSV. Spreadsheets interpret texts that begin with ``=``, ``+``, ``-`` or ``@`` as formulas.

    An apostrophe in front prevents that. Texts of numbers are unchanged. The writer of the file must add quotes.
    """
    text = terminal(text)
    if not text.lstrip().startswith(("=", "+", "-", "@")):
        return text
    try:
        float(text)
    except ValueError:
        return f"'{text}"
    return text


def mathtext(text: str) -> str:
    """The text for matplotlib, which interprets text between dollar signs as a formula."""
    return terminal(text).replace("$", r"\$")
