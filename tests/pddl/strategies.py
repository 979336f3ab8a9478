"""Random formulas and items in the normal form of the reader."""

from hypothesis import strategies as st

from kbstore.messages import AssignOp, ComparisonType, Fact, Function, Instance, Operator, SpecialType
from kbstore.model.formulas import (
    And,
    Atom,
    Comparison,
    Exists,
    Forall,
    Imply,
    IsA,
    Not,
    Or,
    Parameter,
    Preference,
    Same,
    Truism,
)

NAMES = ("p", "Q", "robot_at", "wp-7", "at", "start", "over", "a1", "total-cost", "x", "define", "object")
names = st.sampled_from(NAMES)
objects = st.sampled_from((*NAMES, "3d", "7", "kenny", "Wp0", "2nd-floor"))
numbers = st.floats(allow_nan=False, allow_infinity=False)
arguments = st.lists(objects, max_size=3).map(tuple)


@st.composite
def expressions(draw, depth=3):
    """Numeric expressions."""
    kind = draw(st.integers(0, 5 if depth else 2))
    match kind:
        case 0:
            return (draw(numbers),)
        case 1:
            return (Atom(draw(names), draw(arguments)),)
        case 2:
            return (draw(st.sampled_from(SpecialType)),)
        case _:
            operator = draw(st.sampled_from(Operator))
            operands = [draw(expressions(depth - 1)) for _ in range(operator.arity)]
            return (operator, *(token for operand in operands for token in operand))


@st.composite
def comparisons(draw):
    """Comparisons of a term or of a longer expression with any expression."""
    left = draw(expressions().filter(lambda expression: len(expression) > 1 or isinstance(expression[0], Atom)))
    return Comparison(draw(st.sampled_from(ComparisonType)), left, draw(expressions()))


@st.composite
def parameters(draw):
    """Typed variables with different names."""
    chosen = draw(st.lists(names, max_size=3, unique_by=str.lower))
    types = st.lists(names, min_size=1, max_size=3, unique_by=str.lower).map(tuple)
    return tuple(Parameter(name, draw(types)) for name in chosen)


@st.composite
def conditions(draw, depth=3):
    """Conditions without conjunctions in conjunctions, disjunctions in disjunctions, and double negations."""

    def inner(*excluded):
        return draw(conditions(depth - 1).filter(lambda condition: not isinstance(condition, excluded)))

    match draw(st.integers(0, 11 if depth else 4)):
        case 0:
            return Atom(draw(names), draw(arguments))
        case 1:
            return Same(draw(names), draw(names))
        case 2:
            return draw(comparisons())
        case 3:
            return IsA(draw(objects), draw(names))
        case 4:
            return Truism()
        case 5:
            return Not(inner(Not))
        case 6:
            return And(tuple(inner(And, Truism) for _ in range(draw(st.integers(1, 3)))))
        case 7:
            return Or(tuple(inner(Or) for _ in range(draw(st.integers(0, 3)))))
        case 8:
            return Imply(inner(), inner())
        case 9:
            return Exists(draw(parameters()), inner())
        case 10:
            return Forall(draw(parameters()), inner())
        case _:
            return Preference(draw(names), inner())


values = st.lists(objects, max_size=3)
facts = st.builds(Fact, attribute_name=names, values=values, is_negative=st.booleans())
functions = st.builds(
    Function, attribute_name=names, values=values, function_value=numbers, assign_op=st.sampled_from(AssignOp)
)
instances = st.builds(Instance, instance_name=objects, instance_type=names, is_negative=st.booleans())
