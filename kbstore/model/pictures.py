"""Small timelines in SVG, as notebooks show histories, differences and states: no script, readable in dark and light.

The colours of lines and texts are those around the picture. A bar shows its times as a tooltip.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from html import escape

from kbstore.clock import isoformat

MOST_LANES = 25
"""Lanes that are drawn; the number of the others is below them."""

WIDTH, MARGIN, HEIGHT = 760, 230, 18
"""Pixels of a picture, of its labels, and of a lane."""

LONGEST = 34
"""Characters of a label that fit into the margin."""


class Look(StrEnum):
    """The look of a bar: an SVG style."""

    TRUE = "stroke:#2a9d6f;stroke-width:10"
    FALSE = "stroke:#d1495b;stroke-width:5"
    SCHEDULED = "stroke:#2a9d6f;stroke-width:10;stroke-dasharray:2 3"
    SCHEDULED_FALSE = "stroke:#d1495b;stroke-width:5;stroke-dasharray:2 3"
    SUPERSEDED = "stroke:currentColor;stroke-width:10;opacity:.2"
    RUN = "stroke:#4a7fc1;stroke-width:8"
    NUMBER = "stroke:#4a7fc1;stroke-width:2"
    WANTED = "stroke:currentColor;stroke-width:3;opacity:.6"


@dataclass(frozen=True, slots=True)
class Bar:
    """A span of time, up to the right edge if `end` is None; `values` are a number's values at both ends."""

    start: int
    end: int | None
    look: Look
    tip: str
    values: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class Lane:
    """A name, and the shapes beside it."""

    label: str
    bars: Sequence[Bar]


def timeline(lanes: Sequence[Lane], marks: Iterable[tuple[int, str]] = (), note: str = "") -> str:
    """Draw lanes over time, with marks across them and a note below; an empty text if there is nothing to draw."""
    marks = list(marks)
    times = [t for lane in lanes for bar in lane.bars for t in (bar.start, bar.end) if t is not None]
    times += [t for t, _ in marks]
    if not lanes or not times:
        return ""
    first, last = min(times), max(times)
    # open ends are drawn a little beyond the last time
    length = last - first + max((last - first) // 16, 1)

    def x(t: int | None) -> float:
        return WIDTH if t is None else round(MARGIN + (t - first) * (WIDTH - MARGIN) / length, 2)

    parts, y = [], 0
    for lane in lanes[:MOST_LANES]:
        values = [value for bar in lane.bars for value in bar.values or ()]
        height = 2 * HEIGHT if values else HEIGHT
        parts += [_label(lane.label, y), *_bars(lane.bars, x, y, height, values)]
        if values:
            parts.append(_text(12, y + HEIGHT + 13, f"{min(values):g} to {max(values):g}", faint=True))
        y += height
    for t, tip in marks:
        line = f'<line x1="{x(t)}" x2="{x(t)}" y1="0" y2="{y}" style="stroke:currentColor;stroke-width:1"/>'
        parts.append(_titled(tip, line))
    parts.append(_text(MARGIN, y + 14, isoformat(first), faint=True))
    parts.append(_text(max(x(last), WIDTH * 3 / 4), y + 14, isoformat(last), faint=True, anchor="end"))
    if len(lanes) > MOST_LANES:
        parts.append(_text(4, y + 14, f"and {len(lanes) - MOST_LANES:,} more", faint=True))
    if note:
        parts.append(_text(4, y + 30, note, faint=True))
    return _svg(y + 2 * HEIGHT, f"a timeline from {isoformat(first)} until {isoformat(last)}", parts)


def comparison(rows: Sequence[tuple[str, str, str]], numbers: Sequence[tuple[str, float | None, float | None]]) -> str:
    """Draw what held before beside what holds after.

    `rows` have a label and the looks before and after, or no text; `numbers` a function and its values, None undefined.
    """
    left, middle, right = MARGIN + 20, MARGIN + 130, MARGIN + 240
    parts, y = [], 0
    for label, before, after in rows[:MOST_LANES]:
        parts.append(_label(label, y))
        for start, look in ((left, before), (middle, after)):
            if look:
                parts.append(_line(start, start + 110, y + HEIGHT / 2, y + HEIGHT / 2, look))
        y += HEIGHT
    for function, old, new in numbers[: max(0, MOST_LANES - len(rows))]:
        slope = 0 if old is None or new is None else 6 if new > old else -6
        parts.append(_label(function, y))
        parts.append(_line(left, right, y + HEIGHT / 2 + slope, y + HEIGHT / 2 - slope, Look.NUMBER))
        shown = " to ".join("undefined" if value is None else f"{value:g}" for value in (old, new))
        parts.append(_text(right + 12, y + 13, shown))
        y += HEIGHT
    parts += [_text(left, y + 14, "before", faint=True), _text(right, y + 14, "after", faint=True, anchor="end")]
    left_out = len(rows) + len(numbers) - MOST_LANES
    if left_out > 0:
        parts.append(_text(4, y + 14, f"and {left_out:,} more", faint=True))
    return _svg(y + 2 * HEIGHT, "the difference between two times", parts) if y else ""


def _bars(
    bars: Sequence[Bar], x: Callable[[int | None], float], y: float, height: float, values: Sequence[float]
) -> Iterator[str]:
    """Draw the bars of a lane: those of no length as ticks, numbers as lines from the lowest to the highest value."""
    low = min(values, default=0.0)
    room = (max(values, default=0.0) - low) or 1

    def lift(value: float) -> float:
        return round(y + height - 4 - (value - low) / room * (height - 8), 2)

    for bar in bars:
        left, right = x(bar.start), max(x(bar.end), x(bar.start) + 2)
        top, bottom = (lift(bar.values[0]), lift(bar.values[1])) if bar.values else (y + height / 2, y + height / 2)
        yield _titled(bar.tip, _line(left, right, top, bottom, bar.look))


def _line(x1: float, x2: float, y1: float, y2: float, style: str) -> str:
    return f'<line x1="{x1:g}" x2="{x2:g}" y1="{y1:g}" y2="{y2:g}" style="{style}"/>'


def _label(text: str, y: float) -> str:
    short = text if len(text) <= LONGEST else f"{text[: LONGEST // 2]}…{text[-(LONGEST // 2) :]}"
    return _titled(text, _text(4, y + 13, short))


def _text(x: float, y: float, text: str, *, faint: bool = False, anchor: str = "start") -> str:
    style = f"fill:currentColor;opacity:{0.7 if faint else 1}"
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}" style="{style}">{escape(text)}</text>'


def _titled(tip: str, drawn: str) -> str:
    return f"<g><title>{escape(tip)}</title>{drawn}</g>"


def _svg(height: float, what: str, parts: Iterable[str]) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" role="img" aria-label="{escape(what)}" width="{WIDTH}" '
        f'height="{height:g}" viewBox="0 0 {WIDTH} {height:g}" style="max-width:100%;font:12px sans-serif">'
        f"{''.join(parts)}</svg>"
    )
