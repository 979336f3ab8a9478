"""One timeline in a transaction."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

from kbstore.clock import OPEN
from kbstore.messages import KnowledgeType
from kbstore.model.timelines import EndCause, Timeline, Value, number_at
from kbstore.storage.records import KnownAssertion, StoredAssertion
from kbstore.writing.pieces import Piece


@dataclass
class KnownPast:
    """The known past of a timeline, as far as it has been read.

    Attributes:
        pieces: the pieces before now, in order of time; the last one may end at now because it goes on.
        rows: the stored rows, including one that begins now.
        since: the time from which on it has been read, in nanoseconds.
        is_edited: whether late knowledge has changed it.
        begun_now: the value that begins now by late knowledge, even if the same value held before.
        is_ended_now: whether the transaction has ended what held until now.
    """

    pieces: tuple[Piece, ...] = ()
    rows: list[KnownAssertion] = field(default_factory=list)
    since: int = OPEN
    is_edited: bool = False
    begun_now: Value | None = None
    is_ended_now: bool = False


_NOTHING: Mapping[int, Any] = MappingProxyType({})
"""No schedule, as nearly all timelines have it; shared by them, as a transaction may touch many thousands."""


class TimelineState:
    """A timeline from now on as stored, and as the transaction leaves it."""

    __slots__ = ("ahead", "cause", "derived", "latest", "past", "stored_ahead", "stored_derived", "timeline", "value")

    def __init__(self, timeline: Timeline, rows: Sequence[StoredAssertion], now: int) -> None:
        self.timeline = timeline
        self.latest: StoredAssertion | None = None
        """The latest stored row that begins no later than now; it may have ended."""
        self.stored_ahead: Mapping[int, StoredAssertion] = _NOTHING
        self.stored_derived: Mapping[int, StoredAssertion] = _NOTHING
        """Rows ahead of a function that moves at another rate from then on, by what runs (rule O5)."""
        self.ahead: dict[int, Value] = {}
        """The scheduled values, by time."""
        self.derived: Mapping[int, Value | None] = _NOTHING
        """The values derived for later times from the schedule and runs; None if nothing holds from then on."""
        later: list[StoredAssertion] = []
        for row in rows:
            if row.initial_time <= now:
                self.latest = row
            else:
                later.append(row)
        if later:
            self.stored_ahead = {row.initial_time: row for row in later if not row.is_derived}
            self.stored_derived = {row.initial_time: row for row in later if row.is_derived}
            self.ahead = {t: row.value for t, row in self.stored_ahead.items()}
            self.derived = {t: row.value for t, row in self.stored_derived.items()}
        base = self.base(now)
        self.value = None if base is None else value_now(timeline.kind, base, now)
        """The value that holds now; a function's has its number at now. None if nothing holds."""
        self.cause = EndCause.REPLACED
        """Why the row that held when the transaction began ends, if it does."""
        self.past: KnownPast | None = None
        """The past, if it has been read."""

    def base(self, now: int) -> StoredAssertion | None:
        """Return the stored row that holds at now; None if there is none."""
        latest = self.latest
        return latest if latest is not None and latest.end_time > now else None

    def is_ended_now(self, now: int) -> bool:
        """Return whether the transaction has ended the current assertion."""
        noted = self.past is not None and self.past.is_ended_now
        return self.value is None and (noted or self.base(now) is not None)

    @property
    def has_schedule(self) -> bool:
        """Whether something is scheduled or derived ahead, or was before the transaction."""
        return bool(self.ahead or self.derived or self.stored_ahead or self.stored_derived)

    @property
    def is_edited(self) -> bool:
        """Whether late knowledge has changed the past."""
        return self.past is not None and self.past.is_edited

    def pieces(self, now: int) -> list[Piece]:
        """Return the pieces of the past that have been read, up to now; the one that holds now ends at `OPEN`."""
        assert self.past is not None
        pieces = list(self.past.pieces)
        if self.value is None:
            return pieces
        base = self.base(now)
        began_now = (base is not None and base.initial_time == now) or self.value == self.past.begun_now
        last = pieces[-1] if pieces and not began_now else None
        if last is not None and last.end == now and last.value_at(self.timeline.kind, now) == self.value:
            return [*pieces[:-1], last._replace(end=OPEN)]
        return [*pieces, Piece(now, OPEN, self.value)]

    def copy(self) -> "Copy":
        """Return a copy of the mutable parts, for `restore`."""
        past = self.past
        # a past that has only been read can be read again
        kept = replace(past, rows=list(past.rows)) if past is not None and past.is_edited else None
        return self.value, self.ahead.copy() if self.ahead else _NOTHING, self.cause, kept

    def restore(self, copy: "Copy") -> None:
        """Undo the changes since the copy was made."""
        self.value, ahead, self.cause, self.past = copy
        self.ahead = dict(ahead)


def value_now(kind: KnowledgeType, row: StoredAssertion, now: int) -> Value:
    """Return the value of a stored row at now: a number with a rate has moved since it was stored."""
    value = row.value
    if kind is not KnowledgeType.FUNCTION or not value[3]:
        return value
    return (False, number_at(value, row.initial_time, now), *value[2:])


Copy = tuple[Value | None, Mapping[int, Value], EndCause, KnownPast | None]
