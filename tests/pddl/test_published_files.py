"""Published domains and problems, if they are beside the project."""

from pathlib import Path

import pytest

from kbstore.errors import PddlSyntaxError
from kbstore.pddl.domain_reader import read_domain
from kbstore.pddl.problem_reader import read_problem

FILES = Path(__file__).parents[3] / "shared" / "data" / "rosplan"

pytestmark = pytest.mark.skipif(not FILES.is_dir(), reason="the published files do not lie beside the project")


@pytest.mark.parametrize(
    ("name", "objects", "facts", "goals", "operators"),
    [("amazon", 7, 9, 1, 6), ("turtlebot", 6, 3, 6, 4), ("untyped", 1, 1, 1, 1)],
)
def test_read(name, objects, facts, goals, operators):
    """Each published pair is read, with the expected numbers of objects, facts, goals and operators."""
    domain = read_domain(FILES / name / "domain.pddl")
    problem = read_problem(FILES / name / "problem.pddl", domain)
    found = (len(problem.instances), len(problem.init), len(problem.goals), len(domain.operators))
    assert found == (objects, facts, goals, operators)


def test_broken_on_purpose():
    """The published problem with a misspelt first word is refused there."""
    domain = read_domain(FILES / "invalid-syntax" / "domain.pddl")
    with pytest.raises(PddlSyntaxError, match="begins with") as caught:
        read_problem(FILES / "invalid-syntax" / "problem.pddl", domain)
    assert (caught.value.line, caught.value.column) == (1, 1)
