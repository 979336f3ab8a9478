"""The types of columns of time: nanoseconds, open ends as None, and `datetime`."""

from datetime import UTC, datetime, timedelta
from typing import Any

from sqlalchemy import BigInteger, ColumnElement, Dialect, TypeDecorator, type_coerce
from sqlalchemy.sql import operators
from sqlalchemy.sql.elements import Null
from sqlalchemy.sql.operators import OperatorType

from kbstore.clock import OPEN, TimeLike, time

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


class _Bound:
    """What columns of time are compared with: any time that kbstore takes (rule T2)."""

    def process_bind_param(self, value: TimeLike | None, dialect: Dialect) -> int | None:
        """Return the nanoseconds of a time."""
        return None if value is None else OPEN if value == OPEN else time(value)


class Nanoseconds(_Bound, TypeDecorator[int]):
    """A time in nanoseconds, None where it is open; compared with any time that kbstore takes (rule T2)."""

    impl = BigInteger
    cache_ok = True

    def process_result_value(self, value: int | None, dialect: Dialect) -> int | None:
        """Return None for an end that is open."""
        return None if value == OPEN else value


class End(Nanoseconds):
    """The end of an assertion in a table; an open end is stored as the greatest number, which None is compared as."""

    cache_ok = True

    def process_bind_param(self, value: TimeLike | None, dialect: Dialect) -> int | None:
        """Return the nanoseconds of a time, the greatest number for None."""
        return OPEN if value is None else super().process_bind_param(value, dialect)

    class comparator_factory(TypeDecorator.Comparator[int]):
        """Compares None as the greatest number."""

        def operate(self, op: OperatorType, *other: Any, **options: Any) -> ColumnElement[Any]:
            """Apply an operator of SQLAlchemy."""
            if other and _is_null(other[0]):
                op = _OF_NULL.get(op, op)
            return super().operate(op, *map(_or_greatest, other), **options)


_OF_NULL: dict[Any, Any] = {operators.is_: operators.eq, operators.is_not: operators.ne}
"""Operators that SQL has for NULL only."""


def _is_null(operand: Any) -> bool:
    return operand is None or isinstance(operand, Null)


def _or_greatest(operand: Any) -> Any:
    if isinstance(operand, list | tuple | set | frozenset):
        return [_or_greatest(each) for each in operand]
    return OPEN if _is_null(operand) else operand


class Timestamp(_Bound, TypeDecorator[datetime]):
    """A time as a `datetime` in UTC, which has microseconds; the rest of the nanoseconds is cut off."""

    impl = BigInteger
    cache_ok = True

    def process_result_value(self, value: int | None, dialect: Dialect) -> datetime | None:
        """Return None for an end that is open."""
        return None if value is None or value == OPEN else _EPOCH + timedelta(microseconds=value // 1000)


def as_datetime(column: ColumnElement[Any]) -> ColumnElement[datetime]:
    """Return a column of time, in nanoseconds, as one of `datetime`."""
    return type_coerce(column, Timestamp)
