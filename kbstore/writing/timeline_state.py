"""One timeline in a transaction."""

from collections.abc import Sequence

from kbstore.messages import KnowledgeType
from kbstore.model.timelines import EndCause, Timeline, Value, number_at
from kbstore.storage.records import StoredAssertion


class TimelineState:
    """What is stored of a timeline from now on, and what the transaction makes of it."""

    __slots__ = ("ahead", "cause", "derived", "latest", "stored_ahead", "stored_derived", "timeline", "value")

    def __init__(self, timeline: Timeline, rows: Sequence[StoredAssertion], now: int) -> None:
        self.timeline = timeline
        self.latest: StoredAssertion | None = None
        """The latest stored row that begins no later than now; it may have ended."""
        self.stored_ahead: dict[int, StoredAssertion] = {}
        self.stored_derived: dict[int, StoredAssertion] = {}
        """Rows ahead of a function that moves at another rate from then on, by what runs (rule O5)."""
        for row in rows:
            if row.initial_time <= now:
                self.latest = row
            elif row.is_derived:
                self.stored_derived[row.initial_time] = row
            else:
                self.stored_ahead[row.initial_time] = row
        base = self.base(now)
        self.value: Value | None = None if base is None else base.value
        """What holds now; of a function, with its value at now."""
        if base is not None and timeline.kind is KnowledgeType.FUNCTION:
            self.value = (False, number_at(base.value, base.initial_time, now), *base.value[2:])
        self.ahead: dict[int, Value] = {t: row.value for t, row in self.stored_ahead.items()}
        """What is scheduled, by its time."""
        self.derived: dict[int, Value | None] = {t: row.value for t, row in self.stored_derived.items()}
        """What follows for later times from what is scheduled and runs; None where nothing holds from then on."""
        self.cause = EndCause.REPLACED
        """Why what held at first was ended."""

    def base(self, now: int) -> StoredAssertion | None:
        """The stored row that holds at now."""
        latest = self.latest
        return latest if latest is not None and latest.end_time > now else None

    def copy(self) -> tuple[Value | None, dict[int, Value], EndCause]:
        """What `restore` takes back."""
        return self.value, self.ahead.copy(), self.cause

    def restore(self, copy: tuple[Value | None, dict[int, Value], EndCause]) -> None:
        """Take back what was done since the copy."""
        self.value, self.ahead, self.cause = copy
