"""Random conditions, worlds and histories over one small domain, for Hypothesis."""

from itertools import pairwise

from hypothesis import strategies as st

from kbstore.clock import SECOND
from kbstore.evaluation.interpretation import Number
from kbstore.messages import ComparisonType, Operator
from kbstore.model.domain import DerivedRule, Domain
from kbstore.model.expressions import NumericExpression
from kbstore.model.formulas import (
    And,
    Atom,
    Comparison,
    Defined,
    Exists,
    Forall,
    Formula,
    Imply,
    IsA,
    Not,
    Or,
    Parameter,
    Preference,
    Same,
    Truism,
)
from tests.evaluation.interpretations import History, World, signature, signatures

X, Y, Z = "?x", "?y", "?z"
ZERO = (0.0,)


def exists(declaration: str, part: Formula) -> Exists:
    """``exists("x:place", ...)``."""
    return Exists(parameters(declaration), part)


def forall(declaration: str, part: Formula) -> Forall:
    """``forall("x:place y:robot", ...)``."""
    return Forall(parameters(declaration), part)


def parameters(declaration: str) -> tuple[Parameter, ...]:
    """The parameters of ``"x:place y:robot|dock"``."""
    return signature(f"p {declaration}").parameters


def rule(head: str, condition: Formula) -> DerivedRule:
    """A rule for the head ``"reach x:place y:place"``."""
    return DerivedRule(signature(head), condition)


RULES = {
    "reach": (
        rule("reach x:place y:place", Atom("linked", (X, Y))),
        rule("reach x:place y:place", exists("z:place", And((Atom("linked", (X, Z)), Atom("reach", (Z, Y)))))),
    ),
    # even and odd are one stratum; odd is reached through an opaque disjunction
    "even": (
        rule(
            "even x:place",
            Or((Atom("free", (X,)), exists("y:place", And((Atom("linked", (X, Y)), Atom("odd", (Y,))))))),
        ),
    ),
    "odd": (
        rule(
            "odd x:place",
            exists(
                "y:place",
                And((Atom("linked", (X, Y)), forall("y:robot", Imply(Atom("at", (Y, X)), Atom("even", (X,)))))),
            ),
        ),
        rule("odd x:dock", Not(Or((Not(Atom("even", (X,))), Atom("free", ("?",)))))),
    ),
    "stuck": (rule("stuck x:robot", forall("y:place", Imply(Atom("reach", (Y, Y)), Not(Atom("at", (X, Y)))))),),
    "low": (rule("low x:robot", Comparison(ComparisonType.LESS, (Atom("level", (X,)),), (Atom("total"),))),),
    "calm": (rule("calm", Not(exists("x:robot", Or((Atom("low", (X,)), Atom("stuck", (X,))))))),),
}

DOMAIN = Domain(
    "mission",
    types={"thing": "object", "place": "thing", "dock": "place", "robot": "thing"},
    constants={"home": "dock"},
    predicate_signatures=signatures(
        "at r:robot p:place",
        "free p:place",
        "linked a:place b:place",
        "seen t:thing",
        "alarm",
        "reach a:place b:place",
        "even p:place",
        "odd p:place",
        "stuck r:robot",
        "low r:robot",
        "calm",
    ),
    function_signatures=signatures("level r:robot", "cost p:place", "total"),
    rules=RULES,
)
FREE_OF_RULES = Domain(
    DOMAIN.name,
    DOMAIN.types,
    DOMAIN.constants,
    {name: s for name, s in DOMAIN.predicate_signatures.items() if name not in RULES},
    DOMAIN.function_signatures,
)

OBJECTS = {"r1": "robot", "r2": "robot", "p1": "place", "p2": "place", "d1": "dock"}
PLACES = ["p1", "p2", "d1", "home"]
FACTS = [
    *(f"at {r} {p}" for r in ("r1", "r2") for p in PLACES),
    *(f"free {p}" for p in PLACES),
    *(f"linked {a} {b}" for a in PLACES for b in PLACES),
    *(f"seen {t}" for t in (*PLACES, "r1", "r2")),
    "alarm",
]
FUNCTIONS = ["level r1", "level r2", "cost p1", "cost d1", "total"]
TYPES = ["object", "thing", "place", "dock", "robot"]


def mentions(text: str) -> set[str]:
    """The objects that a fact or function mentions."""
    return set(text.split()[1:]) - {"home"}


# -- formulas -------------------------------------------------------------------------------------------------


@st.composite
def terms(draw: st.DrawFn, scope: tuple[str, ...], wild: bool = False) -> str:
    """An argument: a variable in scope, an object, one that does not exist, a wildcard."""
    names = [*OBJECTS, "home", "ghost"]
    return draw(st.sampled_from([*[f"?{v}" for v in scope] * 6, *names, *(["?", "?loose"] if wild else [])]))


@st.composite
def atoms(draw: st.DrawFn, scope: tuple[str, ...], domain: Domain) -> Atom:
    """An atom of any predicate, not necessarily of the right types."""
    name = draw(st.sampled_from(list(domain.predicate_signatures)))
    arguments = [draw(terms(scope, wild=True)) for _ in domain.predicate_signatures[name].parameters]
    return Atom(name, tuple(arguments))


@st.composite
def functions(draw: st.DrawFn, scope: tuple[str, ...]) -> Atom:
    """A function's term."""
    name, arity = draw(st.sampled_from([("level", 1), ("cost", 1), ("total", 0)]))
    return Atom(name, tuple(draw(terms(scope)) for _ in range(arity)))


NUMBERS = st.sampled_from([0.0, 1.0, -1.0, 2.0, 0.5, 3.0, 0.1, 1e200])


@st.composite
def expressions(draw: st.DrawFn, scope: tuple[str, ...], depth: int = 3, linear: bool = False) -> NumericExpression:
    """An expression; if `linear`, one that is linear in all functions."""
    if depth == 0 or draw(st.integers(0, 2)) == 0:
        return (draw(st.one_of(NUMBERS, functions(scope))),)
    operator = draw(st.sampled_from(Operator))
    first = draw(expressions(scope, depth - 1, linear))
    if operator is Operator.UMINUS:
        return (operator, *first)
    if linear and operator in (Operator.MUL, Operator.DIV):
        return (operator, *first, draw(NUMBERS))
    return (operator, *first, *draw(expressions(scope, depth - 1, linear)))


@st.composite
def conditions(
    draw: st.DrawFn, scope: tuple[str, ...] = (), depth: int = 4, linear: bool = False, domain: Domain = DOMAIN
) -> Formula:
    """A condition whose free variables are those in scope."""

    def inner(more: tuple[str, ...] = ()) -> Formula:
        part: Formula = draw(conditions((*scope, *more), depth - 1, linear, domain))
        return part

    def leaf() -> Formula:
        match draw(st.integers(0, 9)):
            case 0:
                return Same(draw(terms(scope)), draw(terms(scope)))
            case 1:
                return IsA(draw(terms(scope, wild=True)), draw(st.sampled_from([*TYPES, ""])))
            case 2:
                function = draw(functions(scope))
                return Defined(Atom(function.name, tuple(draw(terms(scope, wild=True)) for _ in function.arguments)))
            case 3 | 4 | 5:
                sides = [draw(expressions(scope, linear=linear)) for _ in range(2)]
                return Comparison(draw(st.sampled_from(ComparisonType)), *sides)
            case _:
                return draw(atoms(scope, domain))

    if depth == 0:
        return leaf()
    match draw(st.integers(0, 9)):
        case 0:
            return Not(inner())
        case 1 | 2:
            return And(tuple(inner() for _ in range(draw(st.integers(0, 3)))))
        case 3:
            return Or(tuple(inner() for _ in range(draw(st.integers(0, 3)))))
        case 4:
            return Imply(inner(), inner())
        case 5 | 6 | 7:
            quantifier = Exists if draw(st.booleans()) else Forall
            names = draw(st.lists(st.sampled_from("xyz"), min_size=1, max_size=2, unique=True))
            return quantifier(
                tuple(
                    Parameter(v, tuple(draw(st.lists(st.sampled_from(TYPES), min_size=1, max_size=2)))) for v in names
                ),
                inner(tuple(names)),
            )
        case 8:
            return Truism() if draw(st.booleans()) else Preference("wish", inner())
        case _:
            return leaf()


# -- worlds ---------------------------------------------------------------------------------------------------

VALUES = st.sampled_from([0.0, 1.0, -1.0, 2.0, 0.1, 0.3, 1e308])
RATES = st.sampled_from([0.0, 0.0, 1.0, -0.5, 0.1])


@st.composite
def worlds(draw: st.DrawFn, domain: Domain = DOMAIN) -> World:
    """A world that mentions only existing objects."""
    objects = {name: OBJECTS[name] for name in draw(st.sets(st.sampled_from(list(OBJECTS))))}
    signs = st.sampled_from([None, None, True, True, False])
    time = draw(st.integers(0, 5 * SECOND))
    facts = {text: draw(signs) for text in FACTS if mentions(text) <= objects.keys()}
    numbers = {
        text: Number(draw(VALUES), draw(RATES), draw(st.integers(0, time)))
        for text in FUNCTIONS
        if mentions(text) <= objects.keys() and draw(st.booleans())
    }
    return World(
        domain,
        time=time,
        use_unknowns=draw(st.booleans()),
        objects=objects,
        facts={text: sign for text, sign in facts.items() if sign is not None},
        numbers=numbers,
    )


@st.composite
def histories(draw: st.DrawFn, domain: Domain = DOMAIN) -> History:
    """A history that mentions objects only while they exist."""
    start = draw(st.integers(0, 3))
    end = start + draw(st.integers(1, 12))
    objects = {name: _pieces(draw, start, end, [type_name]) for name, type_name in OBJECTS.items()}
    facts = {text: _pieces(draw, start, end, [True, True, False]) for text in draw(st.sets(st.sampled_from(FACTS)))}
    numbers = {
        text: [
            (a, b, Number(draw(VALUES), draw(RATES) * draw(st.sampled_from([1.0, 1e9, 1e10])), draw(st.integers(0, a))))
            for a, b, _ in _pieces(draw, start, end, [True])
        ]
        for text in FUNCTIONS
    }
    return History(
        (start, end),
        domain,
        use_unknowns=draw(st.booleans()),
        objects=objects,
        facts={text: _within(text, pieces, objects) for text, pieces in facts.items()},
        numbers={text: _within(text, pieces, objects) for text, pieces in numbers.items()},
    )


def _pieces(draw: st.DrawFn, start: int, end: int, values: list) -> list:  # type: ignore[type-arg]
    """Up to three pieces in the span, not necessarily apart."""
    if draw(st.integers(0, 2)) == 0:
        return [(start, end, draw(st.sampled_from(values)))]
    cuts = sorted(draw(st.sets(st.integers(start, end), max_size=4)))
    pieces = [(a, b, draw(st.sampled_from([None, *values]))) for a, b in pairwise(cuts)]
    return [piece for piece in pieces if piece[2] is not None]


def _within(text: str, pieces: list, objects: dict) -> list:  # type: ignore[type-arg]
    """The pieces, cut to where all objects that the text mentions exist."""
    for name in mentions(text):
        pieces = [
            (max(a, c), min(b, d), value)
            for a, b, value in pieces
            for c, d, _ in objects[name]
            if max(a, c) < min(b, d)
        ]
    return pieces
