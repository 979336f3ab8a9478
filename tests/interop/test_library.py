"""The library unified_planning is optional, and other planners understand the problems."""

import subprocess
import sys
from typing import Any

import pytest

from kbstore.errors import KbStoreError
from kbstore.interop.unified_planning import steps, to_problem
from tests.interop.states import state

GO = """
(:durative-action go :parameters (?m - (either robot truck) ?a ?b - place)
  :duration (= ?duration (/ (dist ?a ?b) (speed)))
  :condition (and (at start (at ?m ?a)) (at start (open)) (over all (>= (battery ?m) 0)))
  :effect (and (at start (not (at ?m ?a))) (at end (at ?m ?b)) (at end (visited ?b))
    (decrease (battery ?m) (* #t 2)) (at end (increase (total-cost) ?duration))))
"""
INIT = ["(at kenny wp0)", "(= (dist wp0 wp1) 10)", "(= (dist wp1 wp0) 10)", "(= (speed) 2)", "(= (total-cost) 0)"]


def test_the_library_is_imported_when_it_is_used():
    """Importing kbstore's side of it does not import the library."""
    code = "import kbstore.interop.unified_planning, sys; sys.exit('unified_planning' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_library_that_is_missing_is_a_clear_error(monkeypatch: pytest.MonkeyPatch):
    """The error is an ImportError that says what to install."""
    monkeypatch.setitem(sys.modules, "unified_planning.shortcuts", None)
    with pytest.raises(KbStoreError, match=r"pip install 'kbstore\[planning\]'") as caught:
        to_problem(state())
    assert isinstance(caught.value, ImportError)


@pytest.fixture
def kairos() -> Any:
    """The planner and the validator of up-kairos."""
    up_kairos = pytest.importorskip("up_kairos", reason="the planner up-kairos is not installed")
    up_kairos.register()
    shortcuts = sys.modules["unified_planning.shortcuts"]
    shortcuts.get_environment().credits_stream = None
    return shortcuts


def test_a_planner_finds_a_plan_that_its_validator_accepts(kairos: Any):
    """A temporal, numeric problem with timed literals and continuous effects is planned for."""
    problem = to_problem(
        state(GO, init=[*INIT, "(= (battery kenny) 15)"], goals=["(visited wp1)"], timed={3: "(open)"})
    )
    with kairos.OneshotPlanner(name="kairos") as planner:
        plan = planner.solve(problem, timeout=10).plan
    start, end = steps(plan)
    assert (start.operator, start.arguments, start.duration) == ("go", ("kenny", "wp0", "wp1"), 5_000_000_000)
    assert start.at is not None
    assert start.at >= 3_000_000_000
    assert end.at == start.at + 5_000_000_000
    with kairos.PlanValidator(name="kairos-val") as validator:
        assert validator.validate(problem, plan)


def test_a_planner_finds_no_plan_for_an_empty_battery(kairos: Any):
    """The same problem has no plan if the battery is empty: the continuous effect counts."""
    problem = to_problem(state(GO, init=[*INIT, "(= (battery kenny) 5)"], goals=["(visited wp1)"], timed={3: "(open)"}))
    with kairos.OneshotPlanner(name="kairos") as planner:
        assert planner.solve(problem, timeout=10).plan is None
