"""Domains: every feature of PDDL 2.1 to 3.0 in a small file, and the spellings of real files."""

import pytest

from kbstore.messages import AssignOp, ComparisonType, Operator, SpecialType
from kbstore.model.actions import DurationConstraint
from kbstore.model.formulas import (
    Add,
    And,
    Atom,
    Comparison,
    Delete,
    Exists,
    Forall,
    ForEach,
    Imply,
    Not,
    NumericEffect,
    Or,
    Parameter,
    Preference,
    Same,
    Timing,
    When,
    WhenAtStart,
)
from kbstore.pddl.domain_reader import read_domain

START, ALL, END = Timing.AT_START, Timing.OVER_ALL, Timing.AT_END
P, Q = Atom("p"), Atom("q")


@pytest.fixture
def read(tmp_path):
    """Read a domain of the given sections from a file."""

    def read_sections(sections, name="d"):
        path = tmp_path / "domain.pddl"
        path.write_text(f"(define (domain {name})\n{sections}\n)\n", newline="")
        return read_domain(path)

    return read_sections


@pytest.fixture
def action(read):
    """Read one action, given the text after its name, in a domain with some symbols."""

    def read_action(body, kind="action"):
        domain = read(
            f"""(:types place robot) (:constants home - place) (:predicates (p) (q) (at ?r - robot ?x - place))
            (:functions (f) (g ?x - place) (total-cost)) (:{kind} go {body})"""
        )
        return domain.action("go")

    return read_action


class TestDeclarations:
    def test_empty(self, read):
        """A domain may be empty."""
        domain = read("")
        assert (domain.name, domain.types, domain.actions) == ("d", {}, {})

    def test_types(self, read):
        """Types with parents, also declared after their use, and without any."""
        domain = read("(:types kitchen - room room - place place robot - object item)")
        assert domain.types == {
            "kitchen": "room",
            "room": "place",
            "place": "object",
            "robot": "object",
            "item": "object",
        }
        assert list(domain.supertypes("kitchen")) == ["kitchen", "room", "place", "object"]

    def test_type_with_several_parents(self, read):
        """A type below (either a b) is below both."""
        domain = read("(:types c - (either A b) d - c a b)")
        assert domain.types["c"] == "(either A b)"
        assert domain.is_subtype("d", ["b"])
        assert domain.is_subtype("d", ["a"])
        assert not domain.is_subtype("a", ["b"])

    def test_long_chain_of_types(self, read):
        """A chain of many types is read in time linear in its length."""
        count = 20_000
        types = read(f"(:types {' '.join(f't{index} - t{index + 1}' for index in range(count))})").types
        assert len(types) == count + 1

    def test_parent_that_is_not_declared(self, read):
        """An undeclared parent is a type below object, as in IPC's settlers."""
        assert read("(:types truck - vehicle)").types == {"truck": "vehicle", "vehicle": "object"}

    def test_object_is_declared(self, read):
        """Some files declare object itself."""
        assert read("(:types object robot - object)").types == {"robot": "object"}
        assert read("(:types object - object)").types == {}

    @pytest.mark.parametrize("types", ["area - object area - place", "area - place area - object", "area - place area"])
    def test_type_declared_again_with_a_parent(self, read, types):
        """Some files (IPC's storage) declare a type as an object first, and then with its parent."""
        assert read(f"(:types {types} place)").types == {"place": "object", "area": "place"}

    @pytest.mark.parametrize("types", ["a b - c d", "a b -c d", "a b- c d", "a b\n-c\nd"])
    def test_glued_types(self, read, types):
        """The '-' of a type may be glued to a name."""
        assert read(f"(:types {types})").types == {"a": "c", "b": "c", "c": "object", "d": "object"}

    def test_constants(self, read):
        """Constants with their types in the domain's spelling, also before the types are declared."""
        domain = read("(:constants Home - PLACE it) (:types place)")
        assert domain.constants == {"Home": "place", "it": "object"}

    def test_predicates(self, read):
        """Predicates with typed, untyped and either-typed parameters."""
        domain = read("(:types r p) (:predicates (at ?who - (either r p) ?x ?y - p ?z) (free))")
        assert domain.predicate_signature("AT").parameters == (
            Parameter("who", ("r", "p")),
            Parameter("x", ("p",)),
            Parameter("y", ("p",)),
            Parameter("z"),
        )
        assert str(domain.predicate_signature("free")) == "(free)"

    def test_glued_parameters(self, read):
        """The '-' of a parameter's type may be glued to either side."""
        domain = read("(:types t) (:predicates (a ?x -t) (b ?x- t) (c ?x -t ?y -(either t object)))")
        assert domain.predicate_signature("a") == domain.predicate_signature("b").__class__(
            "a", (Parameter("x", ("t",)),)
        )
        assert domain.predicate_signature("b").parameters == (Parameter("x", ("t",)),)
        assert domain.predicate_signature("c").parameters[1] == Parameter("y", ("t", "object"))

    def test_old_equality(self, read):
        """Equality, which old files declare as a predicate, is built in."""
        assert list(read("(:predicates (= ?x ?y) (p))").predicate_signatures) == ["p"]

    def test_functions(self, read):
        """Numeric functions, with and without '- number'."""
        domain = read("(:types t) (:functions (total-cost) - number (d ?x ?y - t) (e) - number (f) -number)")
        assert [str(signature) for signature in domain.function_signatures.values()] == [
            "(total-cost)",
            "(d ?x - t ?y - t)",
            "(e)",
            "(f)",
        ]

    def test_requirements(self, read):
        """Requirements are kept as written, unknown ones, too."""
        assert read("(:requirements :strips :FLUENTS :no-such-thing)").requirements == (
            ":strips",
            ":FLUENTS",
            ":no-such-thing",
        )

    def test_sections_in_any_order_and_empty(self, read):
        """Sections may be empty, and come in any order."""
        domain = read(
            "(:action a :parameters (?x - t) :precondition (p ?x)) (:functions) (:constants) "
            "(:predicates (p ?x - t)) (:types t)"
        )
        assert domain.action("a").conditions == ((START, Atom("p", ("?x",))),)

    def test_same_section_twice(self, read):
        """The same section with the same words again, as in some IPC files, has no effect."""
        assert len(read("(:predicates (p)) (:predicates\n (p))").predicates) == 1

    def test_spellings(self, read):
        """Mixed case, comments, CRLF, tabs, and an old Lisp form before the definition."""
        domain = read("(:Types\tT ; a type )\r\n)\r\n(:PREDICATES (P ?x - t))\r\n; the end")
        assert domain.predicate_signature("p").parameters == (Parameter("x", ("T",)),)
        assert read_domain('(in-package "PDDL")(DEFINE (DOMAIN d))').name == "d"

    def test_keywords_as_names(self, read):
        """Keywords may name symbols, and names may begin with a digit."""
        domain = read(
            """(:types domain start number at) (:constants define either-or 2nd - at)
            (:predicates (at ?at - at) (over) (start) (when) (object ?x) (total-time) (3d))
            (:action define :parameters (?start - at ?either - start)
              :precondition (and (at ?start) (at define) (over) (start) (when) (object 2nd) (total-time) (3d))
              :effect (and (at 2nd) (when) (not (over))))"""
        )
        assert len(domain.action("define").conditions) == 8
        assert domain.action("define").effects_at(START)[1] == Add(Atom("when"))

    def test_predicate_like_a_connective(self, read):
        """A predicate may even have the name of a connective, where its arguments distinguish it."""
        domain = read(
            """(:predicates (forall ?x) (preference ?x) (p)) (:action a :parameters (?x)
            :precondition (and (forall ?x) (preference n (p)) (preference ?x)) :effect (forall ?x))"""
        )
        assert domain.action("a").conditions_at(START) == (
            Atom("forall", ("?x",)),
            Preference("n", P),
            Atom("preference", ("?x",)),
        )

    def test_source(self, read, tmp_path):
        """The domain keeps its text, comments included."""
        assert "; here" in read("; here").source


class TestActions:
    def test_empty_action(self, action):
        """An action may lack everything; empty groups have no effect."""
        for body in ("", ":parameters () :precondition () :effect ()", ":precondition (and) :effect (and (and) ())"):
            found = action(body)
            assert (found.parameters, found.conditions, found.effects, found.durative) == ((), (), (), False)

    def test_parameters(self, action):
        """Typed parameters."""
        assert action(":parameters (?r - robot ?from ?to - place)").parameters == (
            Parameter("r", ("robot",)),
            Parameter("from", ("place",)),
            Parameter("to", ("place",)),
        )

    def test_variables_of_pddl_1(self, action):
        """The second list of variables of old files is read as more parameters."""
        found = action(":parameters (?r - robot) :vars (?x - place) :precondition (at ?r ?x)")
        assert found.parameters == (Parameter("r", ("robot",)), Parameter("x", ("place",)))

    @pytest.mark.parametrize(
        ("text", "conditions"),
        [
            ("(p)", (P,)),
            ("(and (p) (and (q)))", (P, Q)),
            ("(not (p))", (Not(P),)),
            ("(or (p) (not (q)))", (Or((P, Not(Q))),)),
            ("(imply (p) (q))", (Imply(P, Q),)),
            (
                "(exists (?x - robot) (at ?x home))",
                (Exists((Parameter("x", ("robot",)),), Atom("at", ("?x", "home"))),),
            ),
            ("(forall (?x - place) (> (g ?x) 1))", None),
            ("(= ?y home)", (Same("?y", "home"),)),
            ("(not (= ?y home))", (Not(Same("?y", "home")),)),
            ("(>= (f) (+ (g ?y) 1e1))", None),
            ("(= (f) 3)", (Comparison(ComparisonType.EQUALS, (Atom("f"),), (3.0,)),)),
            ("(= total-cost 3)", (Comparison(ComparisonType.EQUALS, (Atom("total-cost"),), (3.0,)),)),
            ("(preference likes (p))", (Preference("likes", P),)),
            ("(at?r?y)", None),
        ],
    )
    def test_preconditions(self, action, text, conditions):
        """Every form of precondition; conjunctions are split into their parts."""
        if text == "(at?r?y)":
            text = "(at?r ?y)"  # a variable glued to its predicate, as in a published zenotravel
            conditions = (Atom("at", ("?r", "?y")),)
        found = action(f":parameters (?r - robot ?y - place) :precondition {text}").conditions_at(START)
        if conditions is not None:
            assert found == conditions
        else:
            assert len(found) == 1

    @pytest.mark.parametrize(
        ("text", "effects"),
        [
            ("(p)", [Add(P)]),
            ("(not (p))", [Delete(P)]),
            ("(and (p) (and (not (q))))", [Add(P), Delete(Q)]),
            ("(when (p) (q))", [When(P, (Add(Q),))]),
            ("(when (and (p) (not (q))) (and (q) (not (p))))", [When(And((P, Not(Q))), (Add(Q), Delete(P)))]),
            (
                "(forall (?x - robot) (at ?x home))",
                [ForEach((Parameter("x", ("robot",)),), (Add(Atom("at", ("?x", "home"))),))],
            ),
            (
                "(forall (?x - robot) (when (at ?x home) (not (at ?x home))))",
                [
                    ForEach(
                        (Parameter("x", ("robot",)),),
                        (When(Atom("at", ("?x", "home")), (Delete(Atom("at", ("?x", "home"))),)),),
                    )
                ],
            ),
            ("(assign (f) 3)", [NumericEffect(AssignOp.ASSIGN, Atom("f"), (3.0,))]),
            ("(increase (total-cost) 1)", [NumericEffect(AssignOp.INCREASE, Atom("total-cost"), (1.0,))]),
            ("(increase total-cost 1)", [NumericEffect(AssignOp.INCREASE, Atom("total-cost"), (1.0,))]),
            ("(decrease (f) (g home))", [NumericEffect(AssignOp.DECREASE, Atom("f"), (Atom("g", ("home",)),))]),
            ("(scale-up (f) (- 2))", [NumericEffect(AssignOp.SCALE_UP, Atom("f"), (Operator.UMINUS, 2.0))]),
            ("(SCALE-DOWN (f) 2)", [NumericEffect(AssignOp.SCALE_DOWN, Atom("f"), (2.0,))]),
        ],
    )
    def test_effects(self, action, text, effects):
        """Every form of effect, every assignment operator."""
        assert list(action(f":effect {text}").effects_at(START)) == effects


class TestDurativeActions:
    @pytest.mark.parametrize(
        ("text", "constraints"),
        [
            ("()", ()),
            ("(= ?duration 5)", (DurationConstraint(ComparisonType.EQUALS, (5.0,)),)),
            ("( = ?DURATION (g ?x))", (DurationConstraint(ComparisonType.EQUALS, (Atom("g", ("?x",)),)),)),
            (
                "(and (>= ?duration 1) (<= ?duration 5))",
                (
                    DurationConstraint(ComparisonType.GREATEREQ, (1.0,)),
                    DurationConstraint(ComparisonType.LESSEQ, (5.0,)),
                ),
            ),
            ("(< 1 ?duration)", (DurationConstraint(ComparisonType.GREATER, (1.0,)),)),
            ("(at end (<= ?duration (f)))", (DurationConstraint(ComparisonType.LESSEQ, (Atom("f"),), END),)),
            ("(at start (= ?duration 2))", (DurationConstraint(ComparisonType.EQUALS, (2.0,), START),)),
        ],
    )
    def test_duration(self, action, text, constraints):
        """Fixed durations, inequalities, expressions, and their times."""
        found = action(f":parameters (?x - place) :duration {text}", "durative-action")
        assert found.durative
        assert found.duration == constraints

    @pytest.mark.parametrize(
        ("text", "conditions"),
        [
            ("()", ()),
            ("(and)", ()),
            ("(at start (p))", ((START, P),)),
            ("(and (at start (p)) (over all (q)) (and (at end (not (p)))))", ((START, P), (ALL, Q), (END, Not(P)))),
            ("(over all (and (p) (q)))", ((ALL, P), (ALL, Q))),
            ("(at start (at ?r home))", ((START, Atom("at", ("?r", "home"))),)),
            (
                "(forall (?x - robot) (and (at start (at ?x home)) (at end (p))))",
                (
                    (START, Forall((Parameter("x", ("robot",)),), Atom("at", ("?x", "home")))),
                    (END, Forall((Parameter("x", ("robot",)),), P)),
                ),
            ),
            ("(exists (?x - robot) (at start (at ?x home)))", None),
            ("(preference n (over all (p)))", ((ALL, Preference("n", P)),)),
            ("(over all (preference n (p)))", ((ALL, Preference("n", P)),)),
            (
                "(preference n (and (at start (p)) (at start (q)) (at end (p))))",
                ((START, Preference("n", And((P, Q)))), (END, Preference("n", P))),
            ),
            (
                "(at end (> ?duration (f)))",
                ((END, Comparison(ComparisonType.GREATER, (SpecialType.DURATION,), (Atom("f"),))),),
            ),
        ],
    )
    def test_conditions(self, action, text, conditions):
        """Conditions at every time, nested in every way."""
        found = action(f":parameters (?r - robot) :duration (= ?duration 1) :condition {text}", "durative-action")
        if conditions is None:
            ((timing, condition),) = found.conditions
            assert timing is START
            assert isinstance(condition, Exists)
        else:
            assert found.conditions == conditions

    @pytest.mark.parametrize(
        ("text", "effects"),
        [
            ("(and (at start (not (p))) (at end (q)))", ((START, Delete(P)), (END, Add(Q)))),
            ("(at end (and (p) (not (q))))", ((END, Add(P)), (END, Delete(Q)))),
            (
                "(at start (increase (f) ?duration))",
                ((START, NumericEffect(AssignOp.INCREASE, Atom("f"), (SpecialType.DURATION,))),),
            ),
            ("(increase (f) (* #t 2))", ((ALL, NumericEffect(AssignOp.ASSIGN_CTS, Atom("f"), (2.0,))),)),
            ("(decrease (f) (* #t 2))", ((ALL, NumericEffect(AssignOp.ASSIGN_CTS, Atom("f"), (-2.0,))),)),
            (
                "(decrease (f) (* (g home) #t))",
                ((ALL, NumericEffect(AssignOp.ASSIGN_CTS, Atom("f"), (Operator.UMINUS, Atom("g", ("home",))))),),
            ),
            ("(increase (f) #t)", ((ALL, NumericEffect(AssignOp.ASSIGN_CTS, Atom("f"), (1.0,))),)),
            (
                "(increase (f) (/ (* #t 3) 2))",
                ((ALL, NumericEffect(AssignOp.ASSIGN_CTS, Atom("f"), (Operator.DIV, Operator.MUL, 1.0, 3.0, 2.0))),),
            ),
            ("(at end (when (p) (q)))", ((END, When(P, (Add(Q),))),)),
            ("(when (at start (p)) (at start (q)))", ((START, When(P, (Add(Q),))),)),
            ("(when (and (at end (p)) (at end (q))) (at end (not (q))))", ((END, When(And((P, Q)), (Delete(Q),))),)),
            ("(when (at start (p)) (at end (q)))", ((END, WhenAtStart(P, (Add(Q),))),)),
            (
                "(when (and (at end (q)) (at start (p)) (at start (not (q)))) (at end (and (p) (not (q)))))",
                ((END, WhenAtStart(And((P, Not(Q))), (When(Q, (Add(P), Delete(Q))),))),),
            ),
            (
                "(when (at start (p)) (and (at end (q)) (at start (q)) (increase (f) (* #t 2))))",
                (
                    (START, When(P, (Add(Q),))),
                    (ALL, WhenAtStart(P, (NumericEffect(AssignOp.ASSIGN_CTS, Atom("f"), (2.0,)),))),
                    (END, WhenAtStart(P, (Add(Q),))),
                ),
            ),
            (
                "(when (at end (p)) (forall (?x - robot) (when (at start (at ?x home)) (at end (q)))))",
                (
                    (
                        END,
                        When(
                            P,
                            (
                                ForEach(
                                    (Parameter("x", ("robot",)),),
                                    (WhenAtStart(Atom("at", ("?x", "home")), (Add(Q),)),),
                                ),
                            ),
                        ),
                    ),
                ),
            ),
            (
                "(forall (?x - robot) (and (at start (p)) (at end (at ?x home)) (at end (q))))",
                (
                    (START, ForEach((Parameter("x", ("robot",)),), (Add(P),))),
                    (END, ForEach((Parameter("x", ("robot",)),), (Add(Atom("at", ("?x", "home"))), Add(Q)))),
                ),
            ),
        ],
    )
    def test_effects(self, action, text, effects):
        """Effects at start and at end, continuous, conditional and universal ones, in every nesting."""
        assert action(f":duration (= ?duration 1) :effect {text}", "durative-action").effects == effects


class TestRules:
    def test_derived(self, read):
        """Derived predicates; head parameters take the declared types where they have none."""
        domain = read(
            """(:types t) (:predicates (edge ?a ?b - t) (reach ?a ?b - t) (lost ?a - t))
            (:derived (reach ?x ?y) (or (edge ?x ?y) (exists (?z - t) (and (reach ?x ?z) (edge ?z ?y)))))
            (:derived (lost ?x - t) (forall (?y - t) (not (reach ?x ?y))))
            (:derived (LOST ?x) (= ?x ?x))"""
        )
        assert domain.rules["reach"][0].head.parameters == (Parameter("x", ("t",)), Parameter("y", ("t",)))
        assert len(domain.rules["lost"]) == 2
        assert domain.is_derived("Reach")
        assert not domain.is_derived("edge")

    def test_constraints(self, read):
        """Constraints in a domain are read, and kept in its text."""
        domain = read("(:predicates (p)) (:constraints (and (always (p)) (forall (?x) (sometime (p)))))")
        assert "(always (p))" in domain.source


class TestVariablesAndTypes:
    def test_supertype_in_a_condition(self, read):
        """In a condition a variable may be of a supertype: some of its values may fit."""
        domain = read(
            """(:types room - place place) (:predicates (clean ?r - room))
            (:action a :parameters (?p - place) :precondition (clean ?p))"""
        )
        assert domain.action("a").conditions_at(START) == (Atom("clean", ("?p",)),)

    def test_subtype_and_either(self, read):
        """A variable of a subtype, and one whose types all fit, may be in effects."""
        domain = read(
            """(:types room - place place robot) (:predicates (seen ?x - (either place robot)))
            (:action a :parameters (?r - room ?e - (either robot room)) :effect (and (seen ?r) (seen ?e)))"""
        )
        assert len(domain.action("a").effects) == 2

    def test_shadowing(self, read):
        """A quantifier may bind a variable's name again, with another type."""
        domain = read(
            """(:types a b) (:predicates (pa ?x - a) (pb ?x - b))
            (:action go :parameters (?x - a) :precondition (and (pa ?x) (forall (?x - b) (pb ?x))))"""
        )
        assert domain.action("go").conditions[1] == (
            START,
            Forall((Parameter("x", ("b",)),), Atom("pb", ("?x",))),
        )
