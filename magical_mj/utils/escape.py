r"""Untrusted text, such as names and failures from other people's files, in the formats that this package writes.

There is one function for each format. All of them show control characters and what turns the direction of writing
round by their escapes, such as ``\x1b``: none of these has a place in a name, and terminals and browsers obey them.
"""

from __future__ import annotations

import html as _html
import re
from typing import Final

_CONTROL: Final = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
"""All but tabs and ends of lines; the halves of characters cannot even be encoded."""

_MARKDOWN: Final = re.compile(
    r"""
    \\(?=[!-/:-@\[-`{-~]|$)  # backslashes that escape something
    | [*`|~<>]
    | (?<![^\W_])_ | _(?![^\W_])  # inside a word, underscores have no meaning
    | \](?=[(\[:])  # links
    | ^(?:\#{1,6}|[-+])(?=\s|$)  # headings and lists
    | &(?=\#?\w+;)  # entities
    """,
    re.VERBOSE,
)


def terminal(text: str) -> str:
    """The text for a terminal, which would obey escape sequences."""
    return _CONTROL.sub(lambda match: match[0].encode("unicode_escape").decode(), text)


def html(text: object) -> str:
    """The text of something for HTML, in elements and in quoted attributes."""
    return _html.escape(terminal(str(text)))


def markdown(text: str) -> str:
    """The text in one line of Markdown (CommonMark, and GitHub's): in a paragraph, an item of a list, or a table."""
    line = _MARKDOWN.sub(r"\\\g<0>", " ".join(terminal(text).split()))
    return re.sub(r"^\d{1,9}(?=[.)](\s|$))", r"\g<0>\\", line)  # the first number of a list


def markdown_code(text: str) -> str:
    """The text as code in Markdown; a name with other signs than letters, digits and ``.-_`` is no code."""
    return f"`{text}`" if re.fullmatch(r"[\w.-]+", text) else markdown(text)


def markdown_link(text: str, target: str) -> str:
    """A link in Markdown to a target that is quoted already."""
    inside = re.sub(r"(\\.)|([\[\]])", lambda match: match[1] or f"\\{match[2]}", markdown(text))
    return f"[{inside}]({target})"


def csv(text: str) -> str:
    """The text as a cell of CSV, in which spreadsheets take what begins with ``=``, ``+``, ``-`` or ``@`` as a formula.

    An apostrophe in front prevents that. Texts of numbers stay as they are. Quotes are left to the writer of the file.
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
    """The text for matplotlib, which takes what is between dollar signs as a formula."""
    return terminal(text).replace("$", r"\$")
