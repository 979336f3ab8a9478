"""docs/semantics.md has all rules, and the tests cite no others."""

import re

import kbstore
from kbstore.clock import ManualClock
from tests.docs.blocks import ROOT

PAGE = (ROOT / "docs" / "semantics.md").read_text(encoding="utf-8")
COUNTS = {"T": 6, "V": 11, "C": 13, "L": 9, "D": 4, "Q": 9, "O": 8, "P": 7}
"""The number of rules of each letter; they are numbered from 1."""

RULES = {f"{letter}{number}" for letter, count in COUNTS.items() for number in range(1, count + 1)}
PENDING: set[str] = set()
"""Rules that are not implemented yet."""

LETTERS = "".join(COUNTS)


def test_every_rule_is_there_once():
    """Each rule begins a paragraph, with its number, in order within its section."""
    numbers = re.findall(r"^\*\*([A-Z]\d+)\.\*\*", PAGE, re.MULTILINE)
    assert sorted(numbers) == sorted(RULES)
    for letter in LETTERS:
        own = [number for number in numbers if number.startswith(letter)]
        assert own == sorted(own, key=lambda number: int(number[1:]))


def test_every_long_rule_has_an_example():
    """A rule of more than three lines is followed by an example: a block, or a paragraph that begins so."""
    without = []
    for rule in re.split(r"^(?=\*\*[A-Z]\d+\.\*\*)|^(?=## )", PAGE, flags=re.MULTILINE):
        prose = re.sub(r"^```.*?^```$", "", rule, flags=re.MULTILINE | re.DOTALL)
        long = len([line for line in prose.splitlines() if line.strip()]) > 3
        if rule.startswith("**") and long and "```" not in rule and "*Example.*" not in rule:
            without.append(rule[:8])
    assert not without


def test_every_rule_has_a_test_that_names_it():
    """The number of each rule is in the docstring of some test."""
    cited = set()
    for file in (ROOT / "tests").rglob("test_*.py"):
        if file.name != "test_semantics.py":
            for docstring in re.findall(r'"""(.*?)"""', file.read_text(encoding="utf-8"), re.DOTALL):
                cited |= set(re.findall(rf"\b[{LETTERS}]\d{{1,2}}\b", docstring))
    assert cited >= RULES - PENDING
    assert cited <= RULES


def test_the_seven_expressions():
    """V5: the values are right where the original's are wrong."""
    row = next(line for line in PAGE.splitlines() if line.startswith("| reads `(- 5 3)`"))
    there, here = row.strip("|").split(" | ")
    expressions = re.findall(r"`([^`]+)`", there)
    right = [float(number) for number in re.findall(r"-?\d+(?:\.\d+)?", here)]
    with kbstore.open("sqlite://", clock=ManualClock(1)) as kb:
        assert [kb.value(expression) for expression in expressions] == right
    assert right == [5 - 3, 6 / 3, 2 * 3 + 4, (1 + 2) * (3 + 4), 1 + 2 - 10, -5, 1 + 2 * 3]
