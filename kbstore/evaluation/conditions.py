"""The truth of conditions at one time, and what decides it.

`truth` and `deciding` answer single questions; several questions about one world share an `Evaluation`.
"""

from collections.abc import Iterator, Mapping

from kbstore.evaluation.evaluator import Evaluation
from kbstore.evaluation.interpretation import Interpretation
from kbstore.evaluation.substitution import Bindings, instantiated, instantiated_atom, keyed
from kbstore.messages.enums import Truth
from kbstore.model.formulas import And, Atom, Defined, Exists, Forall, Formula, Imply, Not, Or, Preference, Truism
from kbstore.names import is_wildcard


def truth(
    condition: Formula,
    world: Interpretation,
    bindings: Mapping[str, str] = {},
    *,
    duration: float | None = None,
) -> Truth:
    """Return the truth of a condition in a world (rules V2 to V5, V7 to V9).

    Args:
        condition: nested at most `kbstore.evaluation.wellformed.MAX_DEPTH` levels.
        world: what holds.
        bindings: the object of each free variable; the others match any object, in atoms only.
        duration: the value of ``?duration``, in seconds.

    Raises:
        UnknownSymbol: a predicate, function or type that the domain does not know, in any branch.
        InvalidKnowledge: the condition has no meaning, or needs numbers of absurd size to be decided exactly.
    """
    return Evaluation(world, duration=duration).truth(condition, bindings)


def deciding(
    condition: Formula,
    world: Interpretation,
    bindings: Mapping[str, str] = {},
    *,
    duration: float | None = None,
) -> list[tuple[Formula, Truth]]:
    """Return the smallest parts of a condition that decide its truth, each with its own truth.

    A true disjunction, a false conjunction and a quantifier with a witness or a counterexample are decided by the
    first such part alone; any other conjunction or disjunction by all parts of its own truth. The parts
    are atoms and comparisons, with objects for their variables (for a wildcard: the objects of the first fact that
    matches); a quantifier that needs all of its instances is a part as a whole. Arguments and errors are those of
    `truth`.
    """
    evaluation = Evaluation(world, duration=duration)
    evaluation.truth(condition, bindings)
    parts = list(dict.fromkeys(_deciding(evaluation, condition, keyed(bindings))))
    # a truism explains nothing, unless there is nothing else
    return [part for part in parts if not isinstance(part[0], Truism)] or parts


def _deciding(evaluation: Evaluation, condition: Formula, bindings: Bindings) -> Iterator[tuple[Formula, Truth]]:
    match condition:
        case Not(part) | Preference(_, part):
            yield from _deciding(evaluation, part, bindings)
        case And(parts) if parts:
            yield from _of_parts(evaluation, parts, Truth.FALSE, bindings)
        case Or(parts) if parts:
            yield from _of_parts(evaluation, parts, Truth.TRUE, bindings)
        case Imply(premise, conclusion):
            yield from _of_parts(evaluation, (Not(premise), conclusion), Truth.TRUE, bindings)
        case Exists() | Forall():
            found, inner = evaluation.instance(condition, bindings)
            if found is Truth.TRUE:
                yield from _deciding(evaluation, condition.part, inner)
            else:
                yield instantiated(condition, bindings), evaluation.evaluate(condition, bindings)
        case Atom() | Defined():
            yield _matched(evaluation, condition, bindings), evaluation.evaluate(condition, bindings)
        case _:
            yield instantiated(condition, bindings), evaluation.evaluate(condition, bindings)


def _of_parts(
    evaluation: Evaluation, parts: tuple[Formula, ...], decisive: Truth, bindings: Bindings
) -> Iterator[tuple[Formula, Truth]]:
    """Evaluate a disjunction, where TRUE is decisive, or a conjunction, where FALSE is."""
    truths = [evaluation.evaluate(part, bindings) for part in parts]
    if decisive in truths:
        yield from _deciding(evaluation, parts[truths.index(decisive)], bindings)
        return
    wanted = Truth.UNKNOWN if Truth.UNKNOWN in truths else ~decisive
    for part, its_truth in zip(parts, truths, strict=True):
        if its_truth is wanted:
            yield from _deciding(evaluation, part, bindings)


def _matched(evaluation: Evaluation, condition: Atom | Defined, bindings: Bindings) -> Formula:
    """The atom with objects for its variables, and for its wildcards those of its first match, if it has one."""
    if isinstance(condition, Atom):
        shown, matches = condition, evaluation.matches(condition, bindings)
    else:
        shown, matches = condition.function, evaluation.defined(condition.function, bindings)
    shown = instantiated_atom(shown, bindings)
    wild = [is_wildcard(argument) for argument in shown.arguments]
    row = next(matches, None) if any(wild) else None
    if row is not None:
        shown = Atom(shown.name, tuple(b if w else a for a, b, w in zip(shown.arguments, row, wild, strict=True)))
    return shown if isinstance(condition, Atom) else Defined(shown)
