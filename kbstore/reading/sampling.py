"""Samples the value of an expression at regular times."""

from kbstore.clock import DurationLike, TimeLike, duration, isoformat
from kbstore.errors import DivisionByZero, InvalidTime, UndefinedFunction
from kbstore.reading.questions import Question
from kbstore.reading.reader import Reader
from kbstore.storage.repository import Repository

Sample = tuple[int, float | None]
"""A time in nanoseconds, and the value then; None if the expression has none."""


def sampled(
    reader: Reader, repository: Repository, expression: Question, since: TimeLike, until: TimeLike, step: DurationLike
) -> list[Sample]:
    """Return the value of an expression at `since`, and at each `step` from there on before `until`.

    Raises `InvalidTime` if the step is 0 or `until` is before `since`, and what `KnowledgeBase.value` raises, except
    `UndefinedFunction` and `DivisionByZero`.
    """
    first, last, now = reader.resolver.resolve_span(repository, since, until)
    width = duration(step)
    if not width:
        raise InvalidTime("a step of 0 comes to no end; give nanoseconds, as kbstore.seconds(1)")
    if last < first:
        raise InvalidTime(f"until ({isoformat(last)}) is before since ({isoformat(first)}); give them in order")
    reader.questions.expression(expression, reader.symbols_at(repository, now))
    return [(t, _value(reader, repository, expression, t)) for t in range(first, last, width)]


def _value(reader: Reader, repository: Repository, expression: Question, t: int) -> float | None:
    point = reader.resolver.resolve(repository, t)
    symbols = reader.symbols_at(repository, point)
    prepared = reader.questions.expression(expression, symbols)
    try:
        return prepared.evaluate(reader.world(repository, point, symbols.domain))
    except (UndefinedFunction, DivisionByZero):
        return None
