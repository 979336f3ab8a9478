"""Problems as text: exact, and read back to the same state (rules P2 and O4)."""

from dataclasses import dataclass, field

import pytest

from kbstore.clock import seconds
from kbstore.messages import Condition, Expression, Fact, Function, Goal, Inequality, Instance, KnowledgeItem
from kbstore.model.domain import Domain
from kbstore.model.results import Run
from kbstore.pddl.domain_reader import read_domain
from kbstore.pddl.parse import parse_item
from kbstore.pddl.problem_reader import read_problem
from kbstore.pddl.writer import write_domain, write_problem

TEXT = """; a domain
(define (domain rooms)
  (:types robot room)
  (:predicates (at ?r - robot ?x - room) (dark))
  (:functions (battery ?r - robot) (total-cost)))
"""
DOMAIN = read_domain(TEXT)


@dataclass
class State:
    """A state made for the test."""

    at: int = seconds(1000)
    name: str = "kenny"
    domain: Domain | None = DOMAIN
    instances: list[Instance] = field(default_factory=list)
    facts: list[Fact] = field(default_factory=list)
    functions: list[Function] = field(default_factory=list)
    inequalities: list[Inequality] = field(default_factory=list)
    metric: Expression | None = None
    goals: list[Goal] = field(default_factory=list)
    constraints: list[str] = field(default_factory=list)
    timed_constraints: list[tuple[int, str]] = field(default_factory=list)
    timed_knowledge: list[KnowledgeItem] = field(default_factory=list)
    running: list[Run] = field(default_factory=list)
    end_effects: list[tuple[int, KnowledgeItem, Run]] = field(default_factory=list)


def items(*texts):
    """Items from their text, labelled by the domain."""
    return [parse_item(text, DOMAIN) for text in texts]


def at(time, text):
    """An item that takes effect later."""
    return parse_item(text, DOMAIN).changed(initial_time=time)


OBJECTS = [Instance(instance_name="kenny", instance_type="robot"), Instance(instance_name="hall", instance_type="room")]


class TestWhole:
    def test_text(self):
        """A problem as a person would write it."""
        state = State(
            instances=OBJECTS,
            facts=items("(at kenny hall)", "(not (dark))"),
            functions=items("(= (battery kenny) 80)"),
            metric=parse_item("minimize (+ (total-time) (total-cost))"),
            goals=[*items("(at kenny hall)", "(> (battery kenny) 20)"), Condition(text="(or (dark) (dark))")],
            constraints=["(always (dark))"],
        )
        assert write_problem(state) == (
            """(define (problem kenny)
  (:domain rooms)
  (:objects
    kenny - robot
    hall - room
  )
  (:init
    (at kenny hall)
    (= (battery kenny) 80)
  )
  (:goal (and
    (at kenny hall)
    (> (battery kenny) 20)
    (or (dark) (dark))
  ))
  (:constraints (always (dark)))
  (:metric minimize (+ (total-time) (total-cost)))
)
"""
        )

    def test_empty(self):
        """An empty problem is valid, with and without a domain."""
        assert read_problem(write_problem(State()), DOMAIN).goals == []
        assert read_problem(write_problem(State(domain=None))).domain_name == "unknown"

    def test_reading_back(self):
        """A written problem reads back equal."""
        state = State(
            instances=OBJECTS,
            facts=items("(at kenny hall)", "(not (dark))"),
            functions=items("(= (battery kenny) 0.1)", "(= (total-cost) 100000000000000000000)"),
            metric=items("maximize (- (battery kenny) (* 2 (total-time)))")[0],
            goals=[
                *items("(dark)", "(not (at kenny hall))", "(>= (battery kenny) 0.000001)"),
                Condition(text="(or (dark))"),
            ],
            constraints=["(always (dark))", "(within 5 (dark))"],
            timed_knowledge=[at(seconds(1001), "(dark)"), at(seconds("1060.5"), "(= (battery kenny) 3)")],
        )
        problem = read_problem(write_problem(state, explicit_negatives=True), DOMAIN)
        assert problem.instances == state.instances
        assert problem.init == [*state.facts, *state.functions]
        assert problem.metric == state.metric
        assert problem.goals == state.goals
        assert problem.constraints == state.constraints
        assert [(state.at + offset, str(item)) for offset, item in problem.timed] == [
            (item.initial_time, str(item)) for item in state.timed_knowledge
        ]

    @pytest.mark.parametrize(
        ("name", "written"),
        [
            ("kenny", "kenny"),
            ("my robot", "my-robot"),
            ("site/robot1", "site-robot1"),
            ("(x)", "x"),
            ("", "problem"),
            ("a;b", "a-b"),
            ("7", "n-7"),
            ("--", "problem"),
            ("жёлтый", "problem"),
            ("domain", "n-domain"),
        ],
    )
    def test_any_name_of_a_knowledge_base(self, name, written):
        """P5: a knowledge base may have any name; its problem has one that every planner reads."""
        assert read_problem(write_problem(State(name=name)), DOMAIN).name == written

    def test_domain(self):
        """The domain is written as it was loaded, comments included."""
        assert write_domain(DOMAIN) == TEXT


class TestParts:
    def test_explicit_negatives(self):
        """Explicit negatives are left out unless asked for."""
        state = State(facts=items("(not (dark))"))
        assert "dark" not in write_problem(state)
        assert "(not (dark))" in write_problem(state, explicit_negatives=True)

    @pytest.mark.parametrize("value", [0.1, 1e-9, 1e22, -2.5, 5e-324, 1.7976931348623157e308, 1 / 3, -0.0])
    def test_numbers(self, value):
        """Numbers are exact, and never have an exponent."""
        state = State(instances=OBJECTS, functions=[Function(attribute_name="total-cost", function_value=value)])
        text = write_problem(state)
        assert "e" not in text.split("(= (total-cost) ")[1].split(")")[0]
        assert repr(read_problem(text, DOMAIN).init[0].function_value) == repr(value)

    @pytest.mark.parametrize(
        ("offset", "text"),
        [(1, "0.000000001"), (seconds(60), "60"), (seconds("0.5"), "0.5"), (10**18 + 10, "1000000000.00000001")],
    )
    def test_times(self, offset, text):
        """Timed knowledge is written relative to the state's time, exact to the nanosecond."""
        state = State(timed_knowledge=[at(seconds(1000) + offset, "(not (dark))")])
        written = write_problem(state)
        assert f"(at {text} (not (dark)))" in written
        assert read_problem(written, DOMAIN).timed[0][0] == offset

    def test_untyped_objects(self):
        """Where no object has a type, names are written alone; among typed ones they are objects."""
        bare = [Instance(instance_name="a", instance_type="object"), Instance(instance_name="b")]
        assert "\n    a b\n" in write_problem(State(instances=bare))
        mixed = read_problem(write_problem(State(instances=[*bare, *OBJECTS])), DOMAIN).instances
        assert [str(item) for item in mixed] == ["a - object", "b - object", "kenny - robot", "hall - room"]

    def test_dashes(self):
        """Names that begin or end with '-' are not read as type marks, even beside objects named like types."""
        names = ["a-", "robot", "-b", "c", "room", "d-"]
        for type_name in ("robot", "object"):
            instances = [Instance(instance_name=name, instance_type=type_name) for name in names]
            found = read_problem(write_problem(State(instances=instances)), DOMAIN).instances
            assert sorted(map(str, found)) == sorted(f"{name} - {type_name}" for name in names)

    def test_many_objects(self):
        """Objects of a type may need several lines."""
        instances = [Instance(instance_name=f"r{index}", instance_type="room") for index in range(25)]
        text = write_problem(State(instances=instances))
        assert read_problem(text, DOMAIN).instances == instances
        assert max(map(len, text.splitlines())) < 100

    def test_comments(self):
        """Rates, scheduled objects and recorded inequalities are comments, which readers ignore."""
        state = State(
            instances=OBJECTS,
            functions=[parse_item("(= (battery kenny) 80)", DOMAIN).changed(rate=-0.5)],
            inequalities=items("(> (battery kenny) 20)"),
            timed_knowledge=[
                at(seconds(1005), "attic - room"),
                at(seconds(1006), "(not (hall - room))"),
                at(seconds(1007), "(= (total-cost) 1)").changed(rate=2.0),
            ],
        )
        text = write_problem(state)
        for comment in (
            "; (battery kenny) changes by -0.5 per second",
            "; recorded, which PDDL cannot say: (> (battery kenny) 20)",
            "; at 5, which PDDL cannot say: attic - room",
            "; at 6, which PDDL cannot say: (not (hall - room))",
            "; from then on, (total-cost) changes by 2 per second",
        ):
            assert f"    {comment}\n" in text
        problem = read_problem(text, DOMAIN)
        assert [str(item) for item in problem.init] == ["(= (battery kenny) 80)"]
        assert [(offset, str(item)) for offset, item in problem.timed] == [(seconds(7), "(= (total-cost) 1)")]


class TestRunning:
    def test_end_effects(self):
        """A run becomes timed end effects after a comment that names it (rule O4)."""
        go = Run("go", ("kenny", "hall"), seconds(990), seconds("40.5"))
        charge = Run("charge", ("kenny",), seconds(1000), seconds(5))
        state = State(
            instances=OBJECTS,
            running=[go, charge],
            end_effects=[
                (seconds(1005), parse_item("(= (battery kenny) 100)", DOMAIN), charge),
                (seconds("1030.5"), parse_item("(at kenny hall)", DOMAIN), go),
                (seconds("1030.5"), parse_item("(not (dark))", DOMAIN), go),
            ],
        )
        lines = [line.strip() for line in write_problem(state).splitlines()]
        start = lines.index("; (go kenny hall) has been running for 10 s, its end is expected in 30.5 s")
        assert lines[start + 1 : start + 5] == [
            "(at 30.5 (at kenny hall))",
            "(at 30.5 (not (dark)))",
            "; (charge kenny) has been running for 0 s, its end is expected in 5 s",
            "(at 5 (= (battery kenny) 100))",
        ]

    def test_late(self):
        """A run whose expected end has passed is named, and no time is negative."""
        late = Run("go", ("kenny", "hall"), seconds(900), seconds(10))
        text = write_problem(State(running=[late]))
        assert "; (go kenny hall) has been running for 100 s, its end is overdue by 90 s" in text
        assert "(at -" not in text
