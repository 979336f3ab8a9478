"""Truth over time: piecewise constant, combined by Kleene's logic in one sweep (rule V4).

A signal lists the times at which the truth changes, each with the truth from then on; the first is the start of the
span. Times rise strictly, and neighbours differ.
"""

from collections.abc import Iterable, Sequence
from itertools import pairwise

from kbstore.evaluation.interpretation import Span
from kbstore.messages.enums import Truth

Signal = list[tuple[int, Truth]]


def painted(span: Span, pieces: Iterable[tuple[int, int, Truth]], background: Truth) -> Signal:
    """Return the signal of pieces that are in order and do not overlap; between them is the background."""
    signal: Signal = []
    now, last = span[0], None
    for start, end, truth in pieces:
        if start >= end:
            continue
        if start > now and last is not background:
            signal.append((now, background))
            last = background
        if last is not truth:
            signal.append((start, truth))
            last = truth
        now = end
    if (now < span[1] and last is not background) or not signal:
        signal.append((now, background))
    return signal


def inverted(signal: Signal) -> Signal:
    """Return the negation at every time."""
    return [(t, ~truth) for t, truth in signal]


def false_else_unknown(signal: Signal) -> Signal:
    """Return the signal that is false where a signal without unknown is true, else unknown."""
    return [(t, Truth.FALSE if truth is Truth.TRUE else Truth.UNKNOWN) for t, truth in signal]


def conjunction(signals: Sequence[Signal], start: int) -> Signal:
    """Return the conjunction at every time: false where any signal is, else unknown where any is, else true."""
    return _swept(signals, start, Truth.FALSE, Truth.TRUE)


def disjunction(signals: Sequence[Signal], start: int) -> Signal:
    """Return the disjunction at every time: true where any signal is, else unknown where any is, else false."""
    return _swept(signals, start, Truth.TRUE, Truth.FALSE)


def changes(signals: Iterable[Signal]) -> set[int]:
    """The times at which any of the signals changes."""
    return {t for signal in signals for t, _ in signal[1:]}


def pieces(signal: Signal, span: Span) -> list[tuple[int, int, Truth]]:
    """The signal as pieces that fill the span; none if the span is empty."""
    if span[0] >= span[1]:
        return []
    ends = [*signal, (span[1], Truth.UNKNOWN)]
    return [(start, end, truth) for (start, truth), (end, _) in pairwise(ends)]


def _swept(signals: Sequence[Signal], start: int, decisive: Truth, neutral: Truth) -> Signal:
    """Return `decisive` at every time at which any signal is, else unknown if any is, else `neutral`."""
    if len(signals) == 1:
        return signals[0]
    steps: list[tuple[int, int, int]] = []  # time, change in the number of decisive signals, and of unknown ones
    for signal in signals:
        was_decisive = was_unknown = False
        for t, truth in signal:
            is_decisive, is_unknown = truth is decisive, truth is Truth.UNKNOWN
            if is_decisive != was_decisive or is_unknown != was_unknown:
                steps.append((t, is_decisive - was_decisive, is_unknown - was_unknown))
            was_decisive, was_unknown = is_decisive, is_unknown
    steps.sort()
    result: Signal = [(start, neutral)]
    decisives = unknowns = 0
    for t, more_decisive, more_unknown in steps:
        decisives += more_decisive
        unknowns += more_unknown
        truth = decisive if decisives else Truth.UNKNOWN if unknowns else neutral
        if result[-1][0] == t:
            result.pop()
        if not result or result[-1][1] is not truth:
            result.append((t, truth))
    return result
