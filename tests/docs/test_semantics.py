"""docs/semantics.md has all rules, and the tests cite no other."""

import re

import kbstore
from kbstore.clock import ManualClock
from tests.docs.blocks import ROOT

PAGE = (ROOT / "docs" / "semantics.md").read_text(encoding="utf-8")
RULES = {
    *(f"T{n}" for n in range(1, 6)),
    *(f"V{n}" for n in range(1, 10)),
    *(f"C{n}" for n in range(1, 13)),
    *(f"D{n}" for n in range(1, 5)),
    *(f"Q{n}" for n in range(1, 8)),
    *(f"O{n}" for n in range(1, 5)),
    *(f"P{n}" for n in range(1, 4)),
}


def test_every_rule_is_there_once():
    """Each rule begins a paragraph, with its number, in order within its section."""
    numbers = re.findall(r"^\*\*([A-Z]\d+)\.\*\*", PAGE, re.MULTILINE)
    assert sorted(numbers) == sorted(RULES)
    for letter in "TVCDQOP":
        own = [number for number in numbers if number.startswith(letter)]
        assert own == sorted(own, key=lambda number: int(number[1:]))


def test_every_rule_has_a_test_that_names_it():
    """The number of each rule stands in the docstring of some test."""
    cited = set()
    for file in (ROOT / "tests").rglob("test_*.py"):
        if file.name != "test_semantics.py":
            for docstring in re.findall(r'"""(.*?)"""', file.read_text(encoding="utf-8"), re.DOTALL):
                cited |= set(re.findall(r"\b[TVCDQOP]\d{1,2}\b", docstring))
    assert cited >= RULES
    assert not {rule for rule in cited if rule[0] in "TVCDQOP"} - RULES


def test_the_seven_expressions():
    """What the original reckons wrongly comes out as the page says (V5)."""
    row = next(line for line in PAGE.splitlines() if line.startswith("| reads `(- 5 3)`"))
    there, here = row.strip("|").split(" | ")
    expressions = re.findall(r"`([^`]+)`", there)
    right = [float(number) for number in re.findall(r"-?\d+(?:\.\d+)?", here)]
    with kbstore.open("sqlite://", clock=ManualClock(1)) as kb:
        assert [kb.value(expression) for expression in expressions] == right
    assert right == [5 - 3, 6 / 3, 2 * 3 + 4, (1 + 2) * (3 + 4), 1 + 2 - 10, -5, 1 + 2 * 3]
