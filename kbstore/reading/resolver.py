"""The resolver: decides which instant a question means, and whether stored rows answer it.

Every path that reads asks here. A point in time is either *stored*, and its rows are read; or *projected*, and computed
from what was on record (`kbstore.planning.simulator`); or refused, because its history has been archived.
"""

from collections.abc import Sequence
from typing import NamedTuple

from kbstore.clock import OPEN, SECOND, TIME_LIMIT, Clock, SystemClock, TimeLike, isoformat, time
from kbstore.errors import ClockJumped, ClockWentBackwards, HistoryUnavailable
from kbstore.messages import KnowledgeType, format_number
from kbstore.model.results import AsOf, Transaction
from kbstore.model.timelines import Timeline
from kbstore.storage.records import Head, LogPosition, RunRow, StoredPoint
from kbstore.storage.repository import Repository

TOLERANCE = SECOND
"""The most that a clock may be behind the latest recorded time, in nanoseconds (rule T3)."""

MAX_STEP = 3600 * SECOND
"""The most that the system clock may get ahead of what the machine measures, in nanoseconds (rule T6)."""


class TemporalPoint(NamedTuple):
    """The instant that a question means, on both axes of time.

    Attributes:
        valid_time: the time that is asked about, in nanoseconds.
        system_time: the position in the log whose belief is asked for; without `as_of`, now.
        is_as_of: whether the question gave `as_of`.
        head: the end of the log when the question was asked.
        position: the position in the log at which the schedule, the runs and the domain are read.
        rows_at: the position at which the assertions are read; None if they are projected from `position`.
        running: the actions running at `position`, if `valid_time` is after it; otherwise empty.
    """

    valid_time: int
    system_time: LogPosition
    is_as_of: bool
    head: Head
    position: LogPosition
    rows_at: LogPosition | None
    running: Sequence[RunRow]

    @property
    def is_known_now(self) -> bool:
        """Whether the rows that are known now answer: they are stored, and none was recorded after the belief."""
        return self.rows_at is not None and self.rows_at.number is None

    @property
    def is_settled(self) -> bool:
        """Whether nothing recorded from now on, except late knowledge, changes what holds (rule T5)."""
        return self.is_known_now and self.valid_time < self.head.time and self.valid_time < self.system_time.time


class Resolver:
    """Decides which instant a question about one knowledge base means."""

    def __init__(
        self,
        name: str,
        clock: Clock,
        *,
        tolerance: int = TOLERANCE,
        max_step: int = MAX_STEP,
        is_archive: bool = False,
    ) -> None:
        self.name = name
        self.is_archive = is_archive
        self._clock = clock
        self._tolerance = tolerance
        self._max_step = max_step
        # the last accepted reading of the system clock, and the machine's monotonic time then
        self._good = (clock.now(), clock.elapsed()) if isinstance(clock, SystemClock) else None

    # -- now --------------------------------------------------------------------------------------------------

    def read_clock(self) -> int:
        """Return the time of the clock. Raises `InvalidTime` if it is not a time."""
        return time(self._clock.now())

    def now(self, head: Head) -> int:
        """Return now for a question: never before the latest transaction, so that callers see what they wrote (T3)."""
        return max(self.read_clock(), head.time)

    def now_for_writing(self, head: Head) -> int:
        """Return now for a transaction that has locked the head.

        Raises `ClockWentBackwards` where the clock is behind the latest transaction by more than the tolerance (rule
        T3), and `ClockJumped` where it is ahead of what the machine measured by more than the largest step (rule T6).
        """
        clock, latest = self.read_clock(), head.time
        if latest - clock > self._tolerance:
            raise ClockWentBackwards(
                f"the clock says {isoformat(clock)}, but {self.name} has a transaction of {isoformat(latest)}; "
                "set the clock, or give a run that begins anew (a simulation at 0) a knowledge base name of its own; "
                "if that transaction's time was wrong, open with a tolerance that covers the gap"
            )
        self._refuse_jump(clock)
        return max(clock, latest)

    def _refuse_jump(self, clock: int) -> None:
        if self._good is None or not isinstance(self._clock, SystemClock):
            return
        elapsed = self._clock.elapsed()
        wall, measured = self._good
        ahead = (clock - wall) - (elapsed - measured)
        if ahead > self._max_step:
            raise ClockJumped(
                f"the system clock says {isoformat(clock)}, {format_number(ahead / SECOND)} s more than the machine "
                f"has measured since {isoformat(wall)}; nothing has been stored. Set the clock; if it is right now, "
                "open the knowledge base anew, which takes the clock as it is"
            )
        self._good = clock, elapsed

    # -- instants ---------------------------------------------------------------------------------------------

    def resolve(self, repository: Repository, at: TimeLike | None = None, as_of: AsOf | None = None) -> TemporalPoint:
        """Return the instant that a question means, on the snapshot that the repository reads.

        Raises `HistoryUnavailable` if it has been archived, `InvalidTime` for a value that is not a time.
        """
        head = repository.head()
        now = self.now(head)
        believed = self._believed(repository, head, now, as_of)
        t = now if at is None else time(at, now)
        self.refuse_archived(t, head)
        self.refuse_archived(believed.time, head)
        is_as_of = as_of is not None
        if t <= believed.time:
            # earlier times need no transaction number, unless late knowledge corrected them
            position = believed if t == believed.time and believed.number is not None else LogPosition(t)
            rows_at: LogPosition | None = position
            if t < believed.time and self._is_corrected(repository, head, t, believed):
                rows_at = LogPosition(t, believed.number)
            return TemporalPoint(t, believed, is_as_of, head, position, rows_at, ())
        running = repository.running(believed) if head.last_run else ()
        # scheduled rows have the ends that are expected now: right for now's belief, if nothing runs
        rows_at = None if is_as_of or running else LogPosition(t)
        return TemporalPoint(t, believed, is_as_of, head, believed, rows_at, running)

    def _believed(self, repository: Repository, head: Head, now: int, as_of: AsOf | None) -> LogPosition:
        """Return the position in the log of the belief that `as_of` means.

        It has a transaction number if late knowledge may have been recorded after it (rule L4).
        """
        if as_of is None:
            return LogPosition(now)
        if isinstance(as_of, Transaction):
            return repository.after_transaction(as_of.number, as_of.time)
        t = min(time(as_of, now), now)
        number = repository.last_number_at(t) if head.late and t < head.time else head.number
        return LogPosition(t) if number >= head.late else LogPosition(t, number, number)

    @staticmethod
    def _is_corrected(repository: Repository, head: Head, t: int, believed: LogPosition) -> bool:
        """Return whether late knowledge about `t` or earlier was recorded after the belief."""
        if believed.number is None or head.late <= believed.number:
            return False
        return repository.late_from(believed.number) <= t

    @staticmethod
    def at_position(head: Head, position: LogPosition) -> TemporalPoint:
        """Return the instant of a position in the log, as of that position."""
        return TemporalPoint(position.time, position, True, head, position, position, ())

    def resolve_stored(
        self, repository: Repository, kind: KnowledgeType, timeline: Timeline | None, at: TimeLike | None
    ) -> tuple[int, StoredPoint] | None:
        """Return the time that a question about one timeline means, and what is stored of the timeline then.

        A quick form of `resolve`. None if that is needed, which also reads what runs and refuses what cannot be
        answered: the time is projected or archived, or the store has gone back. `at` is not a text, which may be
        relative.
        """
        t = self.read_clock() if at is None else at if type(at) is int else time(at)
        point = repository.value_at(kind, timeline, t)
        if at is None and point is not None and point[1] > t:
            # a caller always sees what it wrote, also where the clock is behind (rule T3)
            t = point[1]
            point = repository.value_at(kind, timeline, t)
        if point is None:
            return None
        _, latest, history_from, _, last_run = point[:5]
        if t > latest and (self.is_archive or (last_run and t > self.read_clock())):
            return None
        return (t, point) if history_from <= t < TIME_LIMIT else None

    def resolve_span(
        self,
        repository: Repository,
        since: TimeLike | None,
        until: TimeLike | None,
        as_of: AsOf | None = None,
    ) -> tuple[int, int, TemporalPoint]:
        """Return a span of time as ``since <= t < until``, and now, or the instant of the belief.

        `since` None is the beginning, `until` None the end of time. Raises `HistoryUnavailable` if a part of the span
        has been archived.
        """
        point = self.resolve(repository)
        now = point.valid_time
        first = 0 if since is None else time(since, now)
        last = OPEN if until is None else time(until, now)
        self.refuse_archived(first, point.head)
        if until is not None:
            self.refuse_archived(max(first, last - 1), point.head)
        if as_of is not None:
            believed = self._believed(repository, point.head, now, as_of)
            self.refuse_archived(believed.time, point.head)
            point = self.at_position(point.head, believed)
        return first, last, point

    def known_by(self, repository: Repository, point: TemporalPoint) -> int | None:
        """Return the number of the last transaction of a point's belief; None if all of them belong to it."""
        return self.last_number(repository, point.system_time) if point.is_as_of else None

    @staticmethod
    def last_number(repository: Repository, position: LogPosition) -> int:
        """Return the number of the last transaction up to a position in the log."""
        return repository.last_number_at(position.time) if position.number is None else position.number

    # -- archives ---------------------------------------------------------------------------------------------

    def refuse_archived(self, t: int, head: Head) -> None:
        """Raise `HistoryUnavailable` if a time was archived; in an archive, also if it is after the end (rule Q7)."""
        if self.is_archive and t > head.time:
            raise HistoryUnavailable(
                f"this archive of {self.name} ends at {isoformat(head.time + 1)}, and {isoformat(t)} cannot be "
                "answered here: ask the store that it was taken from, or a later archive"
            )
        if t < head.history_from:
            raise self.archived(isoformat(t), head)

    def archived(self, asked: str, head: Head) -> HistoryUnavailable:
        """Return the error for a question that needs archived history."""
        return HistoryUnavailable(
            f"{self.name} keeps its history from {isoformat(head.history_from)} on; what was before has been "
            f"archived, and {asked} cannot be answered here: ask the archive"
        )
