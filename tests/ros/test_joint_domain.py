"""One domain of several files, as PlanSys2's parameter `model_file` names them."""

import pytest

from kbstore.errors import PddlSyntaxError
from kbstore.pddl.domain_reader import read_domain
from kbstore.ros.joint_domain import joint_domain

FIRST = """
; rooms
(define (domain rooms) (:requirements :typing :strips)
  (:types robot room)
  (:constants hall - room)
  (:predicates (robot_at ?r - robot ?p - room))
  (:action go :parameters (?r - robot ?a ?b - room) :precondition (robot_at ?r ?a) :effect (robot_at ?r ?b)))
"""
SECOND = """
(define (domain doors) (:requirements :typing :fluents)
  (:types door - object)
  (:predicates (robot_at ?r - robot ?p - room) (open ?d - door))
  (:functions (width ?d - door)))
"""


def test_one_file_stays_as_it_is(tmp_path):
    """A single file is loaded by its path, so that errors name it."""
    assert joint_domain(str(tmp_path / "a.pddl")) == tmp_path / "a.pddl"


def test_sections_of_several_files_are_joined(tmp_path):
    """Requirements and declarations that are equal occur once; a name without a type is an object."""
    (tmp_path / "a.pddl").write_text(FIRST)
    (tmp_path / "b.pddl").write_text(SECOND)
    domain = read_domain(joint_domain(f"{tmp_path / 'a.pddl'}:{tmp_path / 'b.pddl'}"))
    assert domain.name == "rooms_doors"
    assert dict(domain.types) == {"robot": "object", "room": "object", "door": "object"}
    assert dict(domain.constants) == {"hall": "room"}
    assert list(domain.predicate_signatures) == ["robot_at", "open"]
    assert list(domain.function_signatures) == ["width"]
    assert list(domain.actions) == ["go"]
    assert domain.requirements == (":typing", ":strips", ":fluents")


def test_files_that_are_not_domains_are_refused(tmp_path):
    """The error names a missing file, or one that is not a domain."""
    (tmp_path / "a.pddl").write_text(FIRST)
    (tmp_path / "p.pddl").write_text("(define (problem p))")
    with pytest.raises(PddlSyntaxError, match=r"p\.pddl.*not a domain"):
        joint_domain(f"{tmp_path / 'a.pddl'}:{tmp_path / 'p.pddl'}")
    with pytest.raises(PddlSyntaxError, match=r"missing\.pddl"):
        joint_domain(f"{tmp_path / 'a.pddl'}:{tmp_path / 'missing.pddl'}")
