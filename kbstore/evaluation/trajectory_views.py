"""Two views of a trajectory: one that caches what it reads, and one at a single time of the span."""

from bisect import bisect_right
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import TypeVar

from kbstore.evaluation.interpretation import Arguments, Number, Span, Trajectory
from kbstore.model.domain import Domain

_Key = TypeVar("_Key")
_Value = TypeVar("_Value")
_Piece = TypeVar("_Piece", bound=tuple[int, int, object] | Span)


class CachedTrajectory:
    """A trajectory that reads each thing of another one only once (a `Trajectory`)."""

    def __init__(self, trajectory: Trajectory) -> None:
        self.span: Span = trajectory.span
        self.domain: Domain | None = trajectory.domain
        self.use_unknowns: bool = trajectory.use_unknowns
        self._trajectory = trajectory
        self._signs: dict[tuple[str, Arguments], Sequence[tuple[int, int, bool]]] = {}
        self._all_signs: dict[str, Mapping[Arguments, Sequence[tuple[int, int, bool]]]] = {}
        self._numbers: dict[tuple[str, Arguments], Sequence[tuple[int, int, Number]]] = {}
        self._lifespans: dict[tuple[str, ...], Mapping[str, Sequence[Span]]] = {}
        self._existence: dict[str, Sequence[tuple[int, int, str]]] = {}

    def signs(self, name: str, arguments: Arguments) -> Sequence[tuple[int, int, bool]]:
        """The pieces in which one fact is asserted or denied, each with its sign."""
        if name in self._all_signs:
            return self._all_signs[name].get(arguments, ())
        return _cached(self._signs, (name, arguments), lambda: self._trajectory.signs(name, arguments))

    def all_signs(self, name: str) -> Mapping[Arguments, Sequence[tuple[int, int, bool]]]:
        """The pieces of every fact of a predicate that is asserted or denied somewhere in the span."""
        return _cached(self._all_signs, name, lambda: self._trajectory.all_signs(name))

    def numbers(self, name: str, arguments: Arguments) -> Sequence[tuple[int, int, Number]]:
        """The pieces in which one numeric function is defined."""
        return _cached(self._numbers, (name, arguments), lambda: self._trajectory.numbers(name, arguments))

    def lifespans(self, types: Iterable[str]) -> Mapping[str, Sequence[Span]]:
        """The objects of some types that exist somewhere in the span, with their lifespans."""
        wanted = tuple(types)
        return _cached(self._lifespans, wanted, lambda: self._trajectory.lifespans(wanted))

    def lifespan(self, name: str) -> Sequence[tuple[int, int, str]]:
        """Return the spans in which an object exists, each with its type."""
        return _cached(self._existence, name, lambda: self._trajectory.lifespan(name))


class TrajectoryAt:
    """A trajectory at one time of its span (an `Interpretation`)."""

    def __init__(self, trajectory: Trajectory, time: int) -> None:
        self.time = time
        self.domain: Domain | None = trajectory.domain
        self.use_unknowns: bool = trajectory.use_unknowns
        self._trajectory = trajectory

    def sign(self, name: str, arguments: Arguments) -> bool | None:
        """True where the fact is asserted, False where it is explicitly false, None where neither is."""
        piece = _piece_at(self._trajectory.signs(name, arguments), self.time)
        return None if piece is None else piece[2]

    def facts(self, name: str) -> Iterator[tuple[Arguments, bool]]:
        """The facts of a predicate, of both signs, each with its sign."""
        for arguments, pieces in self._trajectory.all_signs(name).items():
            piece = _piece_at(pieces, self.time)
            if piece is not None:
                yield arguments, piece[2]

    def number(self, name: str, arguments: Arguments) -> Number | None:
        """The value of a numeric function, None where it is undefined."""
        piece = _piece_at(self._trajectory.numbers(name, arguments), self.time)
        return None if piece is None else piece[2]

    def objects(self, types: Iterable[str]) -> Collection[str]:
        """The objects that exist and are of one of the types or their subtypes, constants included."""
        lifespans = self._trajectory.lifespans(types)
        return [name for name, spans in lifespans.items() if _piece_at(spans, self.time) is not None]

    def type_of(self, name: str) -> str | None:
        """The type of an object or constant, None where it does not exist."""
        piece = _piece_at(self._trajectory.lifespan(name), self.time)
        return None if piece is None else piece[2]


def _piece_at(pieces: Sequence[_Piece], t: int) -> _Piece | None:
    """The piece in which a time lies."""
    i = bisect_right(pieces, t, key=lambda piece: piece[0])
    return pieces[i - 1] if i and t < pieces[i - 1][1] else None


def _cached(known: dict[_Key, _Value], wanted: _Key, read: Callable[[], _Value]) -> _Value:
    if wanted not in known:
        known[wanted] = read()
    return known[wanted]
