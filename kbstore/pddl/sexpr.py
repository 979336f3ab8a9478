"""S-expressions: PDDL text as nested groups of words that can be traced back to their line and column.

The reader is iterative, so that no depth of nesting needs a deep stack, and it takes a group without inner groups
(which is what nearly all of a problem consists of) in one step.
"""

import os
import re
from bisect import bisect_right
from functools import cached_property
from pathlib import Path

from kbstore.errors import PddlSyntaxError
from kbstore.names import unstorable

MAX_DEPTH = 500_000
"""Brackets nested deeper than this are refused, so that a hostile file cannot fill the memory."""

_COMMENT = re.compile(r";[^\r\n]*")
_LINE_END = re.compile(r"\r\n?|\n")
_TOKEN = re.compile(r"\(([^()]*+)\)|([()])|[^\s()]+")
_CHILD = re.compile(r"[()]|[^\s()]+")
_SHOWN = 100
_SENTENCE = 1000


class Group(list["str | Group"]):
    """A list in brackets: words, as written, and inner groups.

    `start` is the offset of the opening bracket; -1 for a whole text, and the word's offset for a word that is read as
    a group of its own. Words carry no offset: `SourceText.offset` finds it again when a report needs it.
    """

    __slots__ = ("start",)

    start: int

    def word(self, index: int) -> str:
        """Return the word at a place in lower case, as keywords are compared; empty if there is no word."""
        node = self[index] if index < len(self) else ""
        return node.lower() if isinstance(node, str) else ""

    def is_flat(self) -> bool:
        """Return whether there are words only, and no inner groups."""
        return Group not in map(type, self)


Node = str | Group
"""A word or a group."""


class SourceText:
    """A PDDL text, with the name of its file if it has one."""

    def __init__(self, text: str, name: str | None = None) -> None:
        self.text = text
        self.name = name
        # with its comments blanked out, so that offsets stay
        self._code = _COMMENT.sub(lambda comment: " " * len(comment.group()), text) if ";" in text else text
        self._located: Group | None = None
        self._offsets: list[int] = []

    @classmethod
    def open(cls, source: "str | os.PathLike[str] | SourceText") -> "SourceText":
        """Return the text itself if it is PDDL (it contains a bracket), otherwise the content of the file of that name.

        Raises `PddlSyntaxError` for a file that cannot be read, and for characters that cannot be stored.
        """
        if isinstance(source, SourceText):
            return source
        if not isinstance(source, str | os.PathLike):
            raise PddlSyntaxError(f"give the path of a PDDL file, or PDDL text, not {source!r:.80}", line=0)
        if isinstance(source, str) and "(" in source and not _is_file(source):
            return cls(source.removeprefix("\ufeff"))._checked()
        name = os.fspath(source)
        try:
            content = Path(name).read_bytes()
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) else str(error)
            raise PddlSyntaxError(
                f"cannot read the file {name!r:.200}: {reason}; give the path of a PDDL file, or PDDL text "
                "like '(define (domain ...) ...)'",
                line=0,
            ) from None
        try:
            return cls(content.decode("utf-8-sig"), name)._checked()
        except UnicodeDecodeError:
            return cls(content.decode("latin-1"), name)._checked()

    def _checked(self) -> "SourceText":
        """Return the text itself. Raises `PddlSyntaxError` for a character that cannot be stored, also in a comment."""
        place = unstorable(self.text)
        if place is not None:
            raise self.error(f"the character {self.text[place]!r} cannot be stored; leave it out", place)
        return self

    def place(self, offset: int) -> tuple[int, int]:
        """Return the line and the column of an offset, both counted from 1."""
        line = bisect_right(self._line_starts, offset)
        return line, offset - self._line_starts[line - 1] + 1

    def offset(self, group: Group, index: int | None = None) -> int:
        """Return the offset of a group, or of its child at an index; beyond the last, of the closing bracket."""
        if index is None or (group.start >= 0 and self._code[group.start] != "("):
            return max(group.start, 0)
        offsets = self.offsets(group)
        return offsets[min(index, len(offsets) - 1)]

    def offsets(self, group: Group) -> list[int]:
        """Return the offsets of the children of a group, and last of its closing bracket."""
        if self._located is not group:
            # reports often come in a row for one long group, whose children are located once
            self._located, self._offsets = group, _child_offsets(self._code, group.start)
        return self._offsets

    def error(self, problem: str, offset: int) -> PddlSyntaxError:
        """Return the error for the text at an offset."""
        line, column = self.place(offset)
        problem = bounded(problem)
        begin = offset - column + 1
        end = self._line_starts[line] if line < len(self._line_starts) else len(self.text)
        return PddlSyntaxError(problem, line, column, self.name, self.text[begin:end].rstrip("\r\n"))

    def diagnosis(self, problem: str, offset: int) -> str:
        """Return the error's text: the place, the problem, and the line, or the part of a long one, with a mark."""
        line, column = self.place(offset)
        begin = max(offset - column + 1, offset - _SHOWN // 2)
        end = _LINE_END.search(self.text, begin, begin + _SHOWN)
        shown = self.text[begin : end.start() if end else begin + _SHOWN].replace("\t", " ")
        place = f"{self.name}:{line}:{column}" if self.name else f"line {line}, column {column}"
        return f"{place}: {bounded(problem)}\n      {shown}\n      {' ' * (offset - begin)}^"

    def read(self) -> Group:
        """Parse the text into one group, which has no brackets of its own.

        Raises `PddlSyntaxError` for a bracket that is missing or too many.
        """
        top = current = Group()
        top.start = -1
        stack: list[Group] = []
        for token in _TOKEN.finditer(self._code):
            kind = token.lastindex
            if kind == 1:
                leaf = Group(token[1].split())
                leaf.start = token.start()
                current.append(leaf)
            elif kind is None:
                current.append(token.group())
            elif token.group() == "(":
                inner = Group()
                inner.start = token.start()
                current.append(inner)
                stack.append(current)
                current = inner
                if len(stack) > MAX_DEPTH:
                    raise self.error(f"brackets are nested deeper than {MAX_DEPTH:,} here", inner.start)
            elif stack:
                current = stack.pop()
            else:
                raise self.error("this ')' closes nothing: there is one too many, here or before", token.start())
        if stack:
            raise self._unclosed([*stack[1:], current])
        return top

    @cached_property
    def _line_starts(self) -> list[int]:
        return [0, *(end.end() for end in _LINE_END.finditer(self.text))]

    def _unclosed(self, unclosed: list[Group]) -> PddlSyntaxError:
        """Return the error for a text that ends too early, at the section that swallowed the next one, if any."""
        for section in unclosed[0]:
            if isinstance(section, Group) and section.word(0).startswith(":"):
                for inner in section:
                    if isinstance(inner, Group) and inner.word(0).startswith(":"):
                        line, _ = self.place(inner.start)
                        return self.error(
                            f"a ')' is missing: this section is not closed before the next one, ({inner.word(0)} "
                            f"on line {line}",
                            section.start,
                        )
        return self.error("a ')' is missing: this '(' is never closed", unclosed[-1].start)


def bounded(sentence: str) -> str:
    """Cut off a sentence that a hostile name makes very long."""
    return sentence if len(sentence) <= _SENTENCE else sentence[:_SENTENCE] + " ..."


def node_text(node: Node, limit: int | None = None) -> str:
    """Write a node as text with single spaces, cut off after `limit` characters."""
    pieces: list[str] = []
    size = 0
    is_whole_text = isinstance(node, Group) and node.start < 0
    stack: list[Node] = list(reversed(node)) if is_whole_text else [node]
    while stack:
        part = stack.pop()
        if isinstance(part, Group):
            stack.append(")")
            stack.extend(reversed(part))
            piece = "("
        else:
            piece = part
        if pieces and pieces[-1] != "(" and piece != ")":
            pieces.append(" ")
        pieces.append(piece)
        size += len(piece) + 1
        if limit is not None and size > limit:
            return "".join(pieces)[:limit] + " ..."
    return "".join(pieces)


def _is_file(path: str) -> bool:
    """Return whether a text, although it has a bracket, is the path of a file."""
    return len(path) < 4096 and "\n" not in path and "\0" not in path and os.path.isfile(path)


def _child_offsets(code: str, start: int) -> list[int]:
    """Return the offsets of a group's children, and last of its closing bracket (or of the end of the text)."""
    offsets: list[int] = []
    depth = 0 if start >= 0 else 1
    for token in _CHILD.finditer(code, max(start, 0)):
        if token.group() == ")":
            depth -= 1
            if depth == 0:
                return [*offsets, token.start()]
            continue
        if depth == 1:
            offsets.append(token.start())
        if token.group() == "(":
            depth += 1
    return [*offsets, max(0, len(code.rstrip()) - 1)]
