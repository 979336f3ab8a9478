"""One timeline in a transaction."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

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


class TimelineState:
    """A timeline from now on as stored, and as the transaction leaves it."""

    __slots__ = ("ahead", "cause", "derived", "latest", "past", "stored_ahead", "stored_derived", "timeline", "value")

    def __init__(self, timeline: Timeline, rows: Sequence[StoredAssertion], now: int) -> None:
        self.timeline = timeline
        self.latest: StoredAssertion | None = None
        """The latest stored row that begins no later than now; it may have ended."""
        self.stored_ahead: dict[int, StoredAssertion] = {}
        self.stored_derived: dict[int, StoredAssertion] = {}
        """Rows ahead of a function that moves at another rate from then on, by what runs (rule O5)."""
        self.ahead: dict[int, Value] = {}
        """The scheduled values, by time."""
        self.derived: dict[int, Value | None] = {}
        """The values derived for later times from the schedule and runs; None if nothing holds from then on."""
        for row in rows:
            if row.initial_time <= now:
                self.latest = row
            elif row.is_derived:
                self.stored_derived[row.initial_time] = row
                self.derived[row.initial_time] = row.value
            else:
                self.stored_ahead[row.initial_time] = row
                self.ahead[row.initial_time] = row.value
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
        """Return whether the transaction has ended what had held until now."""
        noted = self.past is not None and self.past.is_ended_now
        return self.value is None and (noted or self.base(now) is not None)

    @property
    def has_schedule(self) -> bool:
        """Whether something is scheduled or derived ahead, or was before the transaction."""
        return bool(self.ahead or self.derived or self.stored_ahead or self.stored_derived)

    @property
    def is_edited(self) -> bool:
        """Whether late knowledge has changed what is known of the past."""
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
        """Return a copy of what may change, for `restore`."""
        past = self.past
        # a past that has only been read can be read again
        kept = replace(past, rows=list(past.rows)) if past is not None and past.is_edited else None
        return self.value, self.ahead.copy(), self.cause, kept

    def restore(self, copy: "Copy") -> None:
        """Undo what was done since the copy was made."""
        self.value, self.ahead, self.cause, self.past = copy


def value_now(kind: KnowledgeType, row: StoredAssertion, now: int) -> Value:
    """Return the value of a stored row at now: a number with a rate has moved since it was stored."""
    value = row.value
    if kind is not KnowledgeType.FUNCTION or not value[3]:
        return value
    return (False, number_at(value, row.initial_time, now), *value[2:])


Copy = tuple[Value | None, dict[int, Value], EndCause, KnownPast | None]
