"""Problems: every feature in a small text, and the spellings of real files."""

import pytest

from kbstore.clock import seconds
from kbstore.messages import Fact, Function, Instance, KeyValue
from kbstore.pddl.domain_reader import read_domain
from kbstore.pddl.problem_reader import read_problem

DOMAIN = read_domain(
    """(define (domain rooms)
    (:types kitchen - room room robot)
    (:constants home - room)
    (:predicates (at ?r - robot ?x - room) (open ?x - room) (dark))
    (:functions (battery ?r - robot) (total-cost)))"""
)


def read(sections, domain=DOMAIN):
    """A problem of the given sections, with a goal unless it has one."""
    goal = "" if "(:goal" in sections.lower() else "(:goal (and))"
    return read_problem(f"(define (problem p)\n(:domain rooms)\n{sections}\n{goal})", domain)


def texts(items):
    """Items as PDDL."""
    return [str(item) for item in items]


class TestFrame:
    def test_names(self, tmp_path):
        """A problem has a name, a domain's name in any case, requirements, and its file."""
        path = tmp_path / "p.pddl"
        path.write_text("(define (problem p1) (:domain ROOMS) (:requirements :x :strips) (:goal ()))")
        problem = read_problem(path, DOMAIN)
        assert (problem.name, problem.domain_name) == ("p1", "ROOMS")
        assert problem.requirements == (":x", ":strips")
        assert problem.source == str(path)

    def test_empty_sections(self):
        """Sections may be empty, or missing."""
        problem = read("(:objects) (:init) (:goal (and))")
        assert (problem.instances, problem.init, problem.timed, problem.goals, problem.metric) == ([], [], [], [], None)

    def test_any_order(self):
        """Sections may come in any order."""
        problem = read("(:goal (open k)) (:metric minimize (total-cost)) (:init (open k)) (:objects k - kitchen)")
        assert texts(problem.goals) == ["(open k)"]

    def test_length(self):
        """The deprecated hint for the plan's length has no effect."""
        assert read("(:length (:serial 3) (:parallel 2))").init == []

    def test_same_metric_twice(self):
        """The same section with the same words again, as in IPC's airport, has no effect."""
        assert str(read("(:metric minimize (total-cost)) (:metric minimize (total-cost))").metric) == (
            "minimize (total-cost)"
        )


class TestObjects:
    def test_types(self):
        """Objects with their types in the domain's spelling; untyped ones are objects."""
        problem = read("(:objects a B - ROOM kenny -robot k- kitchen x)")
        assert problem.instances == [
            Instance(instance_name="a", instance_type="room"),
            Instance(instance_name="B", instance_type="room"),
            Instance(instance_name="kenny", instance_type="robot"),
            Instance(instance_name="k", instance_type="kitchen"),
            Instance(instance_name="x", instance_type="object"),
        ]

    def test_name_that_ends_with_a_dash(self):
        """A name may end with '-' before another type mark."""
        problem = read("(:objects a- robot - room b-)")
        assert texts(problem.instances) == ["a- - room", "robot - room", "b- - object"]

    def test_no_objects_of_a_type(self):
        """A type on a line of its own, as a generator writes it for no objects at all."""
        assert texts(read("(:objects a - room\n  - robot\n b - room)").instances) == ["a - room", "b - room"]

    def test_constants_again(self):
        """A constant that is declared again with its type adds nothing (rule C8)."""
        assert read("(:objects Home - room k - kitchen)").instances == [
            Instance(instance_name="k", instance_type="kitchen")
        ]

    def test_keywords_as_names(self):
        """Objects may have names of keywords, and begin with a digit."""
        problem = read("(:objects at init define object - robot 2nd - room) (:init (at at 2nd) (at define home))")
        assert texts(problem.init) == ["(at at 2nd)", "(at define home)"]


class TestInit:
    def test_facts(self):
        """Facts of each sign, labelled by the domain."""
        problem = read("(:objects kenny - robot) (:init (at Kenny HOME) (not (dark)))")
        assert problem.init == [
            Fact(attribute_name="at", values=[KeyValue("r", "Kenny"), KeyValue("x", "HOME")]),
            Fact(attribute_name="dark", is_negative=True),
        ]

    @pytest.mark.parametrize(
        ("text", "value"),
        [
            ("(= (battery kenny) 80)", 80.0),
            ("(= (battery kenny) -1.50e1)", -15.0),
            ("(= (battery kenny) +.5)", 0.5),
            ("(= (battery kenny) 3.)", 3.0),
            ("(= (battery kenny) (- 5))", -5.0),
            ("(= (battery kenny) 0.1)", 0.1),
            ("(= (battery kenny) 123456789012345678)", 123456789012345678.0),
        ],
    )
    def test_values(self, text, value):
        """Numbers in every spelling."""
        problem = read(f"(:objects kenny - robot) (:init {text})")
        assert problem.init == [
            Function(attribute_name="battery", values=[KeyValue("r", "kenny")], function_value=value)
        ]

    def test_function_without_brackets(self):
        """A function without parameters may lack its brackets."""
        assert texts(read("(:init (= total-cost 0))").init) == ["(= (total-cost) 0)"]

    def test_value_given_twice(self):
        """A value given twice is not a contradiction."""
        assert len(read("(:init (dark) (dark) (= (total-cost) 1) (= (Total-Cost) 1.0))").init) == 4

    def test_mixed_case(self):
        """Names may be written in any case."""
        problem = read("(:objects Kenny - ROBOT) (:INIT (AT kenny home) (= (BATTERY KENNY) 1))")
        assert texts(problem.init) == ["(AT kenny home)", "(= (BATTERY KENNY) 1)"]


class TestTimed:
    def test_literals_and_fluents(self):
        """Timed literals of each sign and timed fluents, with their offsets in nanoseconds (rule P3)."""
        problem = read(
            """(:objects k - kitchen) (:init (open home) (at 60 (open k)) (at 120.5 (not (open k)))
            (at 0.000000001 (= (total-cost) 3)))"""
        )
        assert texts(problem.init) == ["(open home)"]
        assert [(time, str(item)) for time, item in problem.timed] == [
            (60 * 10**9, "(open k)"),
            (120_500_000_000, "(not (open k))"),
            (1, "(= (total-cost) 3)"),
        ]

    @pytest.mark.parametrize("text", ["12.000000001", "4000000.999999999", "0.3", "1e2", "00012.50"])
    def test_exact(self, text):
        """Times are exact to the nanosecond, beyond the precision of a double."""
        problem = read(f"(:init (at {text} (dark)))")
        assert problem.timed[0][0] == seconds(text)

    def test_predicate_called_at(self):
        """A predicate may be named `at`, in a timed literal, too."""
        problem = read("(:objects kenny 5 - robot) (:init (at 5 home) (at 5 (at kenny home)) (at 6 (not (at 5 home))))")
        assert texts(problem.init) == ["(at 5 home)"]
        assert [(time // 10**9, str(item)) for time, item in problem.timed] == [
            (5, "(at kenny home)"),
            (6, "(not (at 5 home))"),
        ]


class TestGoals:
    def test_parts(self):
        """A conjunction is split into facts, negative facts, inequalities and the rest (rule C10)."""
        problem = read(
            """(:objects kenny - robot)
            (:goal (and (at kenny home) (and (not (dark)) (>= (battery kenny) 20)) (or (dark) (open home))))"""
        )
        assert texts(problem.goals) == [
            "(at kenny home)",
            "(not (dark))",
            "(>= (battery kenny) 20)",
            "(or (dark) (open home))",
        ]
        assert problem.goals[0].labels == ("r", "x")

    def test_preferences(self):
        """Preferences are kept, with and without a name, also under forall."""
        problem = read(
            """(:goal (and (dark) (preference p1 (and (dark) (open home))) (preference (dark))
            (forall (?x - room) (preference p2 (open ?x)))))
            (:metric minimize (+ (* 10 (is-violated p1)) (is-violated p2)))"""
        )
        assert texts(problem.goals) == [
            "(dark)",
            "(preference p1 (and (dark) (open home)))",
            "(preference (dark))",
            "(forall (?x - room) (preference p2 (open ?x)))",
        ]
        assert str(problem.metric) == "minimize (+ (* 10 (is-violated p1)) (is-violated p2))"

    def test_constraints(self):
        """Trajectory constraints of every kind are kept as text; with them a goal may be missing."""
        constraints = [
            "(always (dark))",
            "(sometime (open home))",
            "(within 5 (dark))",
            "(at-most-once (dark))",
            "(sometime-after (dark) (open home))",
            "(sometime-before (dark) (open home))",
            "(always-within 3.5 (dark) (open home))",
            "(hold-during 1 2 (dark))",
            "(hold-after 7 (dark))",
            "(at end (dark))",
            "(preference c1 (always (dark)))",
            "(forall (?x - room) (and (sometime (open ?x)) (preference c2 (always (open ?x)))))",
        ]
        text = f"(define (problem p) (:domain rooms) (:constraints (and {' '.join(constraints)})))"
        assert read_problem(text, DOMAIN).constraints == constraints
        assert read("(:constraints (always (dark)))").constraints == ["(always (dark))"]

    @pytest.mark.parametrize(
        "metric",
        [
            "minimize (total-time)",
            "maximize (battery kenny)",
            "minimize (+ (* 2 (total-time)) (- (total-cost) (battery kenny)))",
        ],
    )
    def test_metric(self, metric):
        """Metrics of both directions."""
        assert str(read(f"(:objects kenny - robot) (:metric {metric})").metric) == metric

    def test_metric_without_brackets(self):
        """Functions without parameters may lack their brackets."""
        assert (
            str(read("(:metric MINIMIZE (+ total-time total-cost))").metric) == "minimize (+ (total-time) (total-cost))"
        )


class TestPlaces:
    def test_places(self):
        """Each item has its line and column."""
        problem = read_problem(
            "(define (problem p) (:domain rooms) (:objects a\n  b - room)\n(:init (open a)\n"
            "   (at 5 (dark))\n (= (total-cost) 1))\n(:goal (and (open a) (and\n(dark)))))",
            DOMAIN,
        )
        assert list(problem.places["instances"]) == [(1, 47), (2, 3)]
        assert list(problem.places["init"]) == [(3, 8), (5, 2)]
        assert list(problem.places["timed"]) == [(4, 4)]
        assert list(problem.places["goals"]) == [(6, 13), (7, 1)]
        assert list(problem.places["instances"][1:]) == [(2, 3)]


class TestWithoutDomain:
    def test_shape_only(self):
        """Without a domain a problem is read by its form (rule D2)."""
        problem = read(
            """(:objects a - whatever) (:init (p a b) (at a b) (= (f a) 3) (= total-cost 0) (at 5 (p a b)) (p a b))
            (:goal (and (p a) (q (or)))) """.replace("(q (or))", "(q)"),
            domain=None,
        )
        assert texts(problem.instances) == ["a - whatever"]
        assert texts(problem.init) == ["(p a b)", "(at a b)", "(= (f a) 3)", "(= (total-cost) 0)", "(p a b)"]
        assert problem.init[0].labels == ("", "")
        assert texts(problem.goals) == ["(p a)", "(q)"]


class TestBig:
    def test_many_facts(self):
        """Facts on the fast path are the same as those that are the first of their kind."""
        names = [f"r{index}" for index in range(50)]
        facts = [f"(at {a} home)" for a in names] * 3
        problem = read(f"(:objects {' '.join(names)} - robot) (:init {' '.join(facts)})")
        assert texts(problem.init) == facts
        assert all(fact.labels == ("r", "x") for fact in problem.init)
        assert problem.init[0] == Fact(attribute_name="at", values=[KeyValue("r", "r0"), KeyValue("x", "home")])
        assert (
            problem.init[-1].model_dump()
            == Fact(attribute_name="at", values=[KeyValue("r", "r49"), KeyValue("x", "home")]).model_dump()
        )
