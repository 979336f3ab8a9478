"""Changes of the known past of timelines, by late knowledge (rules L2 to L6)."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from operator import itemgetter

from kbstore.clock import OPEN
from kbstore.messages import KnowledgeType
from kbstore.model.formulas import Atom
from kbstore.model.lifespans import Lifespan, lost_time
from kbstore.model.timelines import EndCause, Value
from kbstore.storage.repository import Repository
from kbstore.writing.change_set import ChangeSet
from kbstore.writing.past_rates import PastRates
from kbstore.writing.pieces import Ended, Piece, cut, is_carried_on, next_change, numbers_in, piece_of
from kbstore.writing.timeline_state import TimelineState


class Past:
    """Changes the past of the timelines of one change set."""

    def __init__(self, change_set: ChangeSet, repository: Repository) -> None:
        self._change_set = change_set
        self._repository = repository
        self._now = change_set.now

    # -- changes ----------------------------------------------------------------------------------------------

    def end_of(self, state: TimelineState, value: Value, since: int) -> int:
        """Return the end of a value that is recorded late and without `until` (rule L2)."""
        following = next_change(self._change_set.known(state, since), state.timeline.kind, since)
        return min(following, *state.ahead, self._end_of_objects(state, value, since))

    def put(self, state: TimelineState, value: Value, since: int, until: int | None, rates: PastRates) -> None:
        """Assert a value since a past time: until a time, or until the next change on its timeline.

        `rates` computes what runs would have added to the rate of a number while it was undefined.
        """
        kind = state.timeline.kind
        end = self.end_of(state, value, since)
        pieces = self._change_set.known(state, since)
        if until is not None:
            end = min(until, self._end_of_objects(state, value, since))
        span = [piece for piece in pieces if piece.overlaps(since, end)]
        late = [Piece(since, end, value)]
        if kind is KnowledgeType.FUNCTION:
            known = [*pieces, *self._superseded(state, since, end)]
            known += self._undefined(state, known, since, end, rates)
            late = numbers_in(known, value, since, end)
        before = next((piece for piece in pieces if piece.end == since), None)
        began = [piece for piece in span if before is None or not is_carried_on(before, piece, kind)]
        if _is_known(kind, began if until is None else span, late, since, until):
            return
        if until is not None:
            ended: Ended | None = (None, EndCause.REMOVED if end == until else EndCause.OBJECT)
        else:
            inherited = [piece.ended for piece in span if piece.end == end]
            ended = inherited[0] if inherited else self._ended_object(state, value, end)
        blank_until = until or end
        left = [
            part
            for piece in pieces
            for part in (
                cut(piece, kind, since, blank_until, EndCause.REPLACED)
                if piece.overlaps(since, blank_until)
                else [piece]
            )
        ]
        if end > self._now:
            late[-1] = late[-1]._replace(end=OPEN)
        else:
            late[-1] = late[-1]._replace(ended=ended)
        self._edit(state, [*left, *late], since, EndCause.REPLACED)

    def blank(self, state: TimelineState, matches: Callable[[Value], bool], since: int, until: int | None) -> None:
        """Remove the values that match: in a span, or with `until` None the one at a time, until the next change."""
        kind = state.timeline.kind
        for piece in self._change_set.known(state, since):
            if piece.overlaps(since, since + 1 if until is None else until) and matches(piece.value):
                start = max(since, piece.start)
                end = (
                    next_change(self._change_set.known(state, since), kind, start)
                    if until is None
                    else min(piece.end, until)
                )
                self._blank(state, lambda value: True, start, end, EndCause.REMOVED)

    def lose(self, state: TimelineState, before: Sequence[Lifespan], on_removed: Callable[[str], None]) -> None:
        """Remove what mentions an object from the times at which it does not exist any more (rule L5).

        `before` are its lifespans before the change; `on_removed` is called if it does not exist now.
        """
        after = self._change_set.existences(state)
        name = state.timeline.key
        for start, end in lost_time(before, after):
            following = min((lifespan.start for lifespan in after if lifespan.start > start), default=OPEN)
            for about in self._change_set.mentioning(state):

                def mentions(value: Value, about: TimelineState = about) -> bool:
                    return name in self._change_set.mentions(about.timeline, value)

                self._blank(about, mentions, start, end, EndCause.OBJECT)
                for t in [t for t in about.ahead if start <= t < following and mentions(about.ahead[t])]:
                    self._change_set.take(about, t, EndCause.OBJECT)
            if start <= self._now < end:
                on_removed(name)

    def _blank(
        self, state: TimelineState, matches: Callable[[Value], bool], start: int, end: int, cause: EndCause
    ) -> None:
        kind = state.timeline.kind
        pieces = self._change_set.known(state, start)
        left = [
            part
            for piece in pieces
            for part in (
                cut(piece, kind, start, end, cause) if piece.overlaps(start, end) and matches(piece.value) else [piece]
            )
        ]
        if left != pieces:
            self._edit(state, left, start, cause)

    def _edit(self, state: TimelineState, pieces: Sequence[Piece], since: int, cause: EndCause) -> None:
        """Replace the known past of a timeline by some pieces, which differ from `since` on."""
        self._change_set.touch(state)
        self._change_set.late_from = min(self._change_set.late_from, since)
        begun = sorted(piece for piece in pieces if piece.start <= self._now)
        assert state.past is not None
        past = [piece._replace(end=min(piece.end, self._now)) for piece in begun if piece.start < self._now]
        # a new object: `roll_back` may restore the one before
        state.past = replace(state.past, pieces=tuple(past), is_edited=True, begun_now=None)
        if begun and begun[-1].end > self._now:
            state.value = begun[-1].value_at(state.timeline.kind, self._now)
            if begun[-1].start == self._now:
                state.past.begun_now = state.value
        elif state.value is not None:
            state.value = None
            state.cause = cause

    # -- objects -----------------------------------------------------------------------------------------------

    def _objects(self, state: TimelineState, value: Value) -> list[TimelineState]:
        names = self._change_set.mentions(state.timeline, value)
        return [about for name in names if (about := self._change_set.object(name)) is not None]

    def _end_of_objects(self, state: TimelineState, value: Value, since: int) -> int:
        lifespans = (span for about in self._objects(state, value) for span in self._change_set.existences(about))
        return min((end for _, end, _ in lifespans if end > since), default=OPEN)

    def _ended_object(self, state: TimelineState, value: Value, end: int) -> Ended | None:
        """Return the transaction that removed an object of a value at `end`, with the cause; None if the clock did."""
        for about in self._objects(state, value):
            for piece in self._change_set.known(about, 0):
                if piece.end == end and piece.ended is not None:
                    return piece.ended[0], EndCause.OBJECT
            if end == self._now and about.is_ended_now(self._now):
                return None, EndCause.OBJECT
        return None

    def _superseded(self, state: TimelineState, start: int, end: int) -> list[Piece]:
        """Return the superseded pieces of a timeline in a span, the latest first; each ends when it was superseded.

        Of what ran after that they say nothing.
        """
        assert state.past is not None
        timelines = [state.timeline] if state.timeline.id else []
        rows = self._repository.history(state.timeline.kind, timelines, start, min(end, self._now))
        found = sorted(((row.superseded, row) for row in rows if row.superseded), key=itemgetter(0), reverse=True)
        times = {row[0]: row[1] for row in self._repository.transactions(number for number, _ in found)}
        # a transaction that has been archived was before the span
        pieces = [
            Piece(row.initial_time, min(row.end_time, times.get(number, start)), row.value) for number, row in found
        ]
        return [piece_of(row, OPEN) for row in state.past.rows] + pieces

    def _undefined(
        self, state: TimelineState, known: Sequence[Piece], start: int, end: int, rates: PastRates
    ) -> Iterator[Piece]:
        """Yield what runs added to the rate of a number in a span, as pieces, where none of `known` covers it."""
        name, *arguments = state.timeline.keys
        last = min(end, self._now)
        edges = {start, last, *(t for piece in known for t in (piece.start, piece.end))}
        for first, following in pairwise(sorted(t for t in edges if start <= t <= last)):
            if not any(piece.overlaps(first, following) for piece in known):
                added = rates.added(Atom(name, tuple(arguments)), first, following)
                ends = [t for t, _ in added[1:]] + [following]
                for (t, rate), until in zip(added, ends, strict=True):
                    yield Piece(t, until, (False, 0.0, 0.0, rate))

    def exists_throughout(self, state: TimelineState, since: int, until: int) -> bool:
        """Return whether an object exists in all of a span."""
        return _covers([(start, end) for start, end, _ in self._change_set.existences(state)], since, until)


def _covers(spans: Sequence[tuple[int, int]], since: int, until: int) -> bool:
    """Return whether spans, which are in order, cover all of another."""
    for start, end in spans:
        if start <= since < end:
            since = end
    return since >= until


def _is_known(kind: KnowledgeType, span: Sequence[Piece], late: Sequence[Piece], since: int, until: int | None) -> bool:
    """Return whether late knowledge is known already: the value begins then, or holds throughout the span (rule L8)."""
    if until is None:
        # numbers are compared without what runs add to their rates
        return bool(span) and span[0].start == since and span[0].value[:3] == late[0].value[:3]
    return _covers([(piece.start, piece.end) for piece in span], since, until) and all(
        piece.value_at(kind, t)[:3] == new.value_at(kind, t)[:3]
        for piece in span
        for new in late
        if piece.overlaps(new.start, new.end)
        for t in [max(piece.start, new.start)]
    )
