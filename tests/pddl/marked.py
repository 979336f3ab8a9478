"""PDDL texts with a mark at the position of an expected refusal."""

from typing import NamedTuple

MARK = "«"


class Marked(NamedTuple):
    """A text without its mark, and the line and column of the mark, from 1."""

    text: str
    line: int
    column: int
    quoted: str


def marked(text: str) -> Marked:
    """The text without its one mark."""
    before, after = text.split(MARK)
    clean = before + after
    line = before.count("\n") + 1
    return Marked(clean, line, len(before.rsplit("\n", 1)[-1]) + 1, clean.split("\n")[line - 1])
