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
    """The past of a timeline that is known, as far as it has been read.

    Attributes:
        pieces: what it comes to, in order of time; what holds now is among them up to now.
        rows: the stored rows, and one that begins now.
        since: from when on it has been read.
        is_edited: whether late knowledge has changed it.
        begun_now: what begins now by late knowledge, also where the same held before.
        is_ended_now: whether what had held until now was ended.
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
        """The values derived for later times from the schedule and runs; None where nothing holds from then on."""
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
        """The value that holds now; of a function, with its number at now."""
        self.cause = EndCause.REPLACED
        """The cause of the end of what held at first."""
        self.past: KnownPast | None = None
        """The time before now, where that has been read."""

    def base(self, now: int) -> StoredAssertion | None:
        """The stored row that holds at now."""
        latest = self.latest
        return latest if latest is not None and latest.end_time > now else None

    def is_ended_now(self, now: int) -> bool:
        """Return whether the transaction has ended what had held until now."""
        noted = self.past is not None and self.past.is_ended_now
        return self.value is None and (noted or self.base(now) is not None)

    @property
    def has_schedule(self) -> bool:
        """Whether something lies ahead, or did before the transaction."""
        return bool(self.ahead or self.derived or self.stored_ahead or self.stored_derived)

    @property
    def is_edited(self) -> bool:
        """Whether late knowledge has changed what is known of the past."""
        return self.past is not None and self.past.is_edited

    def copy(self) -> "Copy":
        """Return the part that `restore` takes back."""
        past = self.past
        # what has only been read can be read again
        kept = replace(past, rows=list(past.rows)) if past is not None and past.is_edited else None
        return self.value, self.ahead.copy(), self.cause, kept

    def restore(self, copy: "Copy") -> None:
        """Take back what was done since the copy."""
        self.value, self.ahead, self.cause, self.past = copy


def value_now(kind: KnowledgeType, row: StoredAssertion, now: int) -> Value:
    """Return the value that a stored row has come to by now: a number may move."""
    value = row.value
    if kind is not KnowledgeType.FUNCTION or not value[3]:
        return value
    return (False, number_at(value, row.initial_time, now), *value[2:])


Copy = tuple[Value | None, dict[int, Value], EndCause, KnownPast | None]
