"""Rules P1 to P3 and O4 for a whole knowledge base: loading problems, and writing them at any time."""

import pytest

import kbstore
from kbstore import seconds
from tests.conftest import DOMAIN, START
from tests.rules.reading import facts, instances, picture, scheduled, texts

PROBLEM = """
(define (problem task)
  (:domain rooms)
  (:objects kenny - robot wp0 wp1 - place)
  (:init (near kenny wp0)
         (= (battery kenny) 80.5)
         (at 60 (open wp1))
         (at 120 (not (open wp1)))
         (at 90.5 (= (battery kenny) 20)))
  (:goal (and (near kenny wp1) (not (raining)) (> (battery kenny) 10)))
  (:metric minimize (cost)))
"""


# -- P1, P3 -------------------------------------------------------------------------------------------------------


def test_a_problem_is_objects_facts_numbers_goals_metric_and_timed_knowledge(open_kb, clock):
    """P1, P3: timed-initial knowledge is relative to the time of loading."""
    kb = open_kb()
    clock.set(START + seconds(5))
    kb.load(DOMAIN, PROBLEM)
    state = kb.state()
    assert texts(state.instances) == ["kenny - robot", "wp0 - place", "wp1 - place"]
    assert texts(state.facts) == ["(near kenny wp0)"]
    assert texts(state.functions) == ["(= (battery kenny) 80.5)"]
    assert texts(state.goals) == ["(> (battery kenny) 10)", "(near kenny wp1)", "(not (raining))"]
    assert str(state.metric) == "minimize (cost)"
    assert scheduled(kb) == [
        (START + seconds(65), "(open wp1)"),
        (START + seconds("95.5"), "(= (battery kenny) 20)"),
        (START + seconds(125), "(not (open wp1))"),
    ]


def test_timed_knowledge_out_of_range_is_refused(kb):
    """T1, P1, P3: also a time after the last possible one; nothing is skipped silently."""
    offset = (kbstore.clock.TIME_LIMIT - START) // seconds(1)
    kb.load(DOMAIN, PROBLEM.replace("at 60", f"at {offset - 1}"))
    assert scheduled(kb)[-1] == (START + seconds(offset - 1), "(open wp1)")
    with pytest.raises(kbstore.InvalidKnowledge, match=r"line 7, column \d+: \(open wp1\) is to take effect after"):
        kb.load(DOMAIN, PROBLEM.replace("at 60", f"at {offset + 1}"))


def test_loading_a_problem_adds_to_the_state(kb):
    """P3: the current state stays."""
    kb.add("(open hall)")
    kb.load(DOMAIN, PROBLEM)
    assert facts(kb) == ["(near kenny wp0)", "(open hall)"]
    assert "cup - item" in instances(kb)


def test_loading_with_replace_clears_first(kb):
    """P3: in the same transaction."""
    before = kb.add("(open hall)", "(near kenny wp1)")
    loaded = kb.load(DOMAIN, PROBLEM, replace=True)
    assert loaded.number == before.number + 1
    assert facts(kb) == ["(near kenny wp0)"]
    assert instances(kb) == ["kenny - robot", "wp0 - place", "wp1 - place"]


def test_files_and_text_are_the_same(open_kb, tmp_path):
    """P1: `load` takes a path or PDDL text."""
    (tmp_path / "domain.pddl").write_text(DOMAIN)
    (tmp_path / "problem.pddl").write_text(PROBLEM)
    by_path, by_text = open_kb(), open_kb()
    by_path.load(tmp_path / "domain.pddl", str(tmp_path / "problem.pddl"))
    by_text.load(DOMAIN, PROBLEM)
    assert picture(by_path) == picture(by_text)


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("(near kenny wp0)", "(near kenny wp9)", 5),
        ("(near kenny wp0)", "(nearby kenny wp0)", 5),
        ("(near kenny wp0)", "(near wp0 kenny)", 5),
        ("80.5", "much", 6),
        ("(:domain rooms)", "(:domain halls)", 3),
        ("wp0 wp1 - place", "wp0 wp1 - palace", 4),
        ("minimize (cost)", "minimize (prize)", 11),
        ("(:metric", "(:metrics", 11),
    ],
)
def test_a_syntax_error_is_refused_with_its_position(open_kb, tmp_path, old, new, line):
    """P1, D1: with file and line, and nothing is stored."""
    problem = tmp_path / "problem.pddl"
    problem.write_text(PROBLEM.replace(old, new))
    kb = open_kb()
    with pytest.raises(kbstore.KbStoreError, match=rf"problem\.pddl:{line}\b"):
        kb.load(DOMAIN, problem)
    assert list(kb.changes()) == []


# -- P2, O4 -------------------------------------------------------------------------------------------------------


def test_a_problem_written_reads_back_to_the_same_state(open_kb, clock):
    """P2: at any t, numbers exactly, the timed-initial knowledge relative to t."""
    kb = open_kb()
    kb.load(DOMAIN, PROBLEM)
    kb.add("(= (distance wp0 wp1) 1e-7)", "(= (cost) 0.1)", "(open home)", "galley - kitchen", "(clean galley)")
    clock.set(START + seconds(70))
    kb.remove("(near kenny wp0)")
    kb.add("(= (cost) 123456789012345680000000)")
    for at in (START, START + seconds("61.25"), START + seconds(70)):
        text = kb.to_pddl(at=at)
        other = open_kb(clock=kbstore.ManualClock(at))
        other.load(DOMAIN, text)
        assert picture(other, at) == picture(kb, at)
        assert kb.state(at).to_pddl() == text


def test_explicit_negatives_are_left_out_of_a_problem(kb):
    """P2: from the initial state; scheduled ends are written."""
    kb.add("(not (raining))", "(open wp0)")
    kb.add("(not (open wp0))", initial_time=START + seconds(60))
    text = kb.to_pddl()
    assert "raining" not in text
    assert "(at 60 (not (open wp0)))" in text


def test_numbers_are_written_without_exponents(kb):
    """P2: they read back to the same double."""
    kb.add("(= (cost) 1e-7)", "(= (battery kenny) 1e22)")
    text = kb.to_pddl()
    assert "0.0000001" in text
    assert "10000000000000000000000" in text


def test_parts_without_pddl_are_comments(kb):
    """P2: rates, scheduled objects, recorded inequalities."""
    kb.add(kbstore.Function(attribute_name="cost", function_value=1, rate=2), "(> (cost) 5)")
    kb.add("box - item", initial_time=START + 10)
    comments = [line for line in kb.to_pddl().splitlines() if line.lstrip().startswith(";")]
    for part in ("cost", "box", "(> (cost) 5)"):
        assert any(part in line for line in comments), part


def test_timed_knowledge_about_a_scheduled_object_is_a_comment(kb, open_kb):
    """P2: the problem could not declare the object, and could not be read back."""
    with kb.transaction() as tx:
        tx.add("wp9 - place", initial_time=START + seconds(5))
        tx.add("(near kenny wp9)", initial_time=START + seconds(6))
        tx.add("(near kenny wp0)", initial_time=START + seconds(7))
        # an object of this name and another type comes after it
        tx.add("(not (wp1 - place))", initial_time=START + seconds(8))
        tx.add("wp1 - robot", initial_time=START + seconds(9))
        tx.add("(near wp1 wp0)", initial_time=START + seconds(10))
    text = kb.to_pddl()
    for comment in ("at 6, which PDDL cannot say: (near kenny wp9)", "at 10, which PDDL cannot say: (near wp1 wp0)"):
        assert f"; {comment}\n" in text
    other = open_kb()
    other.load(DOMAIN, text)
    assert scheduled(other) == [(START + seconds(7), "(near kenny wp0)")]
    assert "(at 1 (near kenny wp9))" in kb.to_pddl(at=START + seconds(5))


def test_a_problem_as_it_was_believed(kb, clock):
    """P2, Q2: `to_pddl` takes `as_of`."""
    kb.add("(open wp0)", initial_time=START + seconds(60))
    clock.set(START + seconds(10))
    kb.remove("(open wp0)", initial_time=START + seconds(60))
    text = kb.to_pddl(at=START + seconds(70), as_of=START + seconds(5))
    assert "(open wp0)" in text
    assert "(open wp0)" not in kb.to_pddl(at=START + seconds(70))
