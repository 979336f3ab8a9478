"""P7: a domain and a problem that have been loaded are not loaded again with once=True."""

from contextlib import suppress
from pathlib import Path

import pytest

import kbstore
from kbstore import KnowledgeBase, ManualClock, PddlSyntaxError, seconds

DOMAIN = "(define (domain d) (:types place) (:predicates (lit ?p - place) (dark)))"
PROBLEM = "(define (problem p) (:domain d) (:objects hall - place) (:init (lit hall)) (:goal (lit hall)))"
OTHER = PROBLEM.replace("hall", "den")


def test_a_problem_is_loaded_once(bare: KnowledgeBase):
    """P7: loading it again does nothing, also after the state has changed."""
    assert bare.load(DOMAIN, PROBLEM, once=True).changes
    bare.remove("(lit hall)")
    before = len(list(bare.changes()))
    again = bare.load(DOMAIN, PROBLEM, once=True)
    assert again.changes == 0
    assert len(list(bare.changes())) == before
    assert not bare.holds("(lit hall)")


def test_also_after_clear_and_with_replace(bare: KnowledgeBase):
    """P7: a load is remembered forever; without `once` the problem is loaded again."""
    bare.load(DOMAIN, PROBLEM)
    bare.clear()
    assert bare.load(DOMAIN, PROBLEM, once=True).changes == 0
    assert bare.state().instances == []
    bare.load(DOMAIN, OTHER)
    assert bare.load(DOMAIN, PROBLEM, once=True, replace=True).changes == 0
    assert bare.holds("(lit den)")
    assert bare.load(DOMAIN, PROBLEM, replace=True).changes
    assert bare.holds("(lit hall)")


def test_another_text_is_another_load(bare: KnowledgeBase):
    """P7: the texts of both are compared, and each is loaded once."""
    bare.load(DOMAIN, PROBLEM)
    assert bare.load(DOMAIN, OTHER, once=True).changes
    bare.clear()
    assert bare.load(DOMAIN, PROBLEM + " ", once=True).changes
    bare.clear()
    assert bare.load(DOMAIN + "; another text", PROBLEM, once=True).changes
    bare.clear()
    for domain, problem in ((DOMAIN, PROBLEM), (DOMAIN, OTHER), (DOMAIN, PROBLEM + " ")):
        assert bare.load(domain, problem, once=True).changes == 0


def test_a_problem_alone_is_loaded_with_the_domain_in_force(bare: KnowledgeBase):
    """P7, D4: load(None, problem) loads the problem with the domain that is in force."""
    bare.load(DOMAIN)
    assert bare.load(None, PROBLEM, once=True).changes
    bare.clear()
    assert bare.load(None, PROBLEM, once=True).changes == 0
    assert bare.load(DOMAIN, PROBLEM, once=True).changes == 0
    assert bare.load(DOMAIN, once=True).changes == 0


def test_a_file_is_compared_by_its_text(bare: KnowledgeBase, tmp_path: Path):
    """P7: wherever the file lies."""
    for name in ("a", "b"):
        (tmp_path / f"{name}.pddl").write_text(DOMAIN)
        (tmp_path / f"{name}-problem.pddl").write_text(PROBLEM)
    bare.load(tmp_path / "a.pddl", tmp_path / "a-problem.pddl", once=True)
    bare.clear()
    assert bare.load(tmp_path / "b.pddl", str(tmp_path / "b-problem.pddl"), once=True).changes == 0
    assert bare.load(DOMAIN, PROBLEM, once=True).changes == 0


def test_a_failed_load_does_not_count(bare: KnowledgeBase):
    """P7, C1: a load that was not stored does not count."""
    with pytest.raises(PddlSyntaxError):
        bare.load(DOMAIN, PROBLEM.replace("(:init", "(:inits"), once=True)
    with suppress(RuntimeError), bare.transaction() as tx:
        tx.load(DOMAIN, PROBLEM)
        raise RuntimeError
    assert bare.load(DOMAIN, PROBLEM, once=True).changes


def test_within_one_transaction(bare: KnowledgeBase):
    """P7: a load earlier in the same transaction counts."""
    with bare.transaction() as tx:
        tx.load(DOMAIN, PROBLEM)
        tx.remove("(lit hall)")
        tx.load(DOMAIN, PROBLEM, once=True)
    assert not bare.holds("(lit hall)")


def test_another_process_and_another_knowledge_base(tmp_path: Path):
    """P7: the record is in the store, for this knowledge base alone, and is copied with its rows."""
    url = str(tmp_path / "kenny.db")
    clock = ManualClock(seconds(100))
    with kbstore.open(url, "kenny", clock=clock) as kb:
        kb.load(DOMAIN, PROBLEM)
        kb.clear()
    with kbstore.open(url, "kenny", clock=clock) as kb:
        assert kb.load(DOMAIN, PROBLEM, once=True).changes == 0
    kbstore.export_knowledge_base(url, "kenny", tmp_path / "kenny.jsonl")
    with kbstore.open(url, "robbie", clock=clock) as other:
        assert other.load(DOMAIN, PROBLEM, once=True).changes
    copy = str(tmp_path / "copy.db")
    kbstore.import_knowledge_base(copy, tmp_path / "kenny.jsonl")
    with kbstore.open(copy, "kenny", clock=clock) as kb:
        assert kb.load(DOMAIN, PROBLEM, once=True).changes == 0


def test_also_after_archiving(tmp_path: Path):
    """P7, Q7: the record of a load stays when its transaction has been archived."""
    clock = ManualClock(seconds(100))
    with kbstore.open(str(tmp_path / "kenny.db"), "kenny", clock=clock) as kb:
        kb.load(DOMAIN, PROBLEM)
        clock.advance(seconds(10))
        kb.clear()
        clock.advance(seconds(10))
        kb.load(DOMAIN, OTHER)
        clock.advance(seconds(10))
        kb.archive(seconds(120), tmp_path / "archive.db")
        assert kb.load(DOMAIN, PROBLEM, once=True).changes == 0


def test_the_record_of_a_load_is_not_part_of_the_state(bare: KnowledgeBase):
    """P7: the record is not in the state, in changes or in exported problems."""
    done = bare.load(DOMAIN, PROBLEM)
    assert done.changes == 4  # the domain, the object, the fact and the goal
    (change,) = bare.changes()
    assert len(change.asserted) == 3
    assert bare.constraints() == []
