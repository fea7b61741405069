"""Escaping of text from outside: harmless to the terminal, to a page, and in names of files."""

from __future__ import annotations

import re
from collections.abc import Iterable

MOST_QUOTED = 200
"""Largest number of characters of a text from outside that a message repeats."""

MAX_STEM = 60
"""Largest number of characters of a part of a file name, numbers of equal ones excepted."""

# Control characters (escape sequences begin with them), marks that reverse the direction of text, line ends
# that a terminal does not know, surrogates, and code points that are not characters.
HIDDEN = re.compile(
    "[\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufff9-\ufffb\ufffe\uffff\ud800-\udfff]"
)

MARKDOWN = str.maketrans(
    {"\\": r"\\", "|": r"\|", "`": r"\`", "*": r"\*", "$": r"\$", "<": "&lt;", "&": "&amp;"}
)


def escape_control(text: str) -> str:
    r"""Spell control characters as Python does, so that a terminal shows them instead of obeying them.

    Examples
    --------
    >>> escape_control("a\x1b[31mb\n")
    'a\\x1b[31mb\\n'
    """
    return HIDDEN.sub(lambda match: match[0].encode("unicode_escape").decode("ascii"), text)


def escape_lines(text: str) -> str:
    """Spell control characters other than line breaks as Python does."""
    return "\n".join(map(escape_control, text.split("\n")))


def escape_json(text: str) -> str:
    """Spell control characters other than line breaks as JSON does."""
    lines = text.split("\n")
    return "\n".join(HIDDEN.sub(lambda match: f"\\u{ord(match[0]):04x}", line) for line in lines)


def quoted(value: object, most: int = MOST_QUOTED) -> str:
    """Write a value from outside as Python does, without its middle where it is too long for a message.

    Examples
    --------
    >>> quoted("a" * 1000, most=11)
    "'aaaa…aaaa'"
    """
    return shortened(repr(value), most)


def shortened(text: str, most: int = MOST_QUOTED) -> str:
    """Leave out the middle of a text that is too long.

    Examples
    --------
    >>> shortened("abcdefgh", most=5)
    'ab…gh'
    """
    half = (most - 1) // 2
    return text if len(text) <= most else f"{text[:half]}…{text[-half:]}"


def plural(number: int, noun: str) -> str:
    """Write a number of things with a noun in the singular or plural.

    Examples
    --------
    >>> plural(1, "point"), plural(2, "point")
    ('1 point', '2 points')
    """
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def in_markdown(text: str) -> str:
    r"""Write text so that Markdown shows it as it is: no tags, no links, no code, no end of a cell.

    Examples
    --------
    >>> in_markdown("a|b <script> [x](y) z[n=1]")
    'a\\|b &lt;script> [x]\\(y) z[n=1]'
    """
    return escape_control(text).translate(MARKDOWN).replace("](", r"]\(")


def file_stems(names: Iterable[str]) -> dict[str, str]:
    """Give every name a part of a file name that is safe and unique on every system.

    Examples
    --------
    >>> file_stems(["street", "../a b", "Street"])
    {'street': 'street', '../a b': 'a-b', 'Street': 'Street-2'}
    """
    stems: dict[str, str] = {}
    taken: set[str] = set()
    for name in names:
        base = re.sub(r"[^A-Za-z0-9_]+", "-", name)[:MAX_STEM].strip("-") or "unnamed"
        stem, number = base, 1
        while stem.lower() in taken:
            number += 1
            stem = f"{base}-{number}"
        taken.add(stem.lower())
        stems[name] = stem
    return stems
