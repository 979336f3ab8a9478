"""The small timelines of notebooks, read as XML: the positions of shapes, and that no name becomes markup."""

from itertools import pairwise
from xml.etree import ElementTree

import pytest

import kbstore
from kbstore import seconds
from kbstore.cli.demo.mission import record
from kbstore.clock import ManualClock
from kbstore.model.assertions import MOST_BARS
from kbstore.model.pictures import LONGEST, MARGIN, MOST_LANES, WIDTH, Look

SVG = "{http://www.w3.org/2000/svg}"
NASTY = "<script>alert(1)</script>\"'&"


@pytest.fixture(scope="module")
def kenny():
    with record("sqlite://") as kb:
        yield kb


def picture(answer):
    """The picture of an answer as XML, which has to be well-formed; the table after it is left out."""
    text = answer._repr_html_()
    return ElementTree.fromstring(text[: text.index("</svg>") + len("</svg>")])


def bars(drawn):
    """The bars of a picture: tooltip, begin, end, and style."""
    found = []
    for group in drawn.iter(f"{SVG}g"):
        line = group.find(f"{SVG}line")
        if line is not None:
            found.append((group.find(f"{SVG}title").text, float(line.get("x1")), float(line.get("x2")), line))
    return found


def words(drawn):
    return [each.text for each in drawn.iter(f"{SVG}text")]


def test_a_history(kenny):
    """Fifteen minutes, and a sixteenth beyond them: a bar is as long as its assertion held, with its style."""
    drawn = picture(kenny.history("(open lab_door)"))
    minute = (WIDTH - MARGIN) / 15 * 16 / 17
    found = bars(drawn)
    for (_, left, right, _), (start, end) in zip(found, ((0, 1), (1, 4), (4, 15)), strict=False):
        assert (left, right) == pytest.approx((MARGIN + start * minute, MARGIN + end * minute), abs=0.1)
    assert [line.get("style") for *_, line in found] == [
        Look.TRUE, Look.FALSE, Look.TRUE, Look.SUPERSEDED, Look.SCHEDULED_FALSE
    ]  # fmt: skip
    assert found[4][2] == WIDTH
    assert found[1][0].startswith("(not (open lab_door)) from 2026-05-04T09:01:00Z until 2026-05-04T09:04:00Z, ")
    assert "fire alarm" in found[1][0]
    assert words(drawn) == ["(open lab_door)", "2026-05-04T09:00:00Z", "2026-05-04T09:15:00Z"]


def test_numbers_are_lines(kenny):
    """A number's lines meet at its corners; below its name is its range."""
    drawn = picture(kenny.history("(battery kenny)"))
    lines = [line for *_, line in bars(drawn)]
    for before, after in pairwise(lines):
        assert (before.get("x2"), before.get("y2")) == (after.get("x1"), after.get("y1"))
    # 62, 62, 56, ... 3.5, 63.5: higher is a smaller y
    heights = [float(line.get("y1")) for line in lines]
    assert heights[-1] == min(heights)
    assert heights[12] == heights[13] == max(heights)
    assert "3.5 to 63.5" in words(drawn)


def test_a_difference(kenny):
    """A fact that became true is after, one that was withdrawn is before; a number slopes."""
    drawn = picture(kenny.diff("2026-05-04T09:06:00Z", "2026-05-04T09:06:50Z"))
    became, withdrew, battery = drawn.iter(f"{SVG}line")
    assert words(drawn)[:4] == ["(robot_at kenny home)", "(undocked kenny)", "(battery kenny)", "15.5 to 3.5"]
    assert float(became.get("x1")) == float(withdrew.get("x2"))
    assert (became.get("style"), withdrew.get("style")) == (Look.TRUE, Look.SUPERSEDED)
    assert float(battery.get("y1")) < float(battery.get("y2"))


def test_a_state(kenny):
    """Runs up to their expected ends, the schedule, and facts from their initial times, up to a mark at the time."""
    drawn = picture(kenny.state("2026-05-04T09:00:45Z"))
    found = {tip: (left, right, line.get("style")) for tip, left, right, line in bars(drawn)}
    now = found.pop("at 2026-05-04T09:00:45Z")[0]
    run, *facts = found.values()
    # 09:00:40 to 09:01:20, of which 5 s are over
    assert (now - run[0]) * 8 == pytest.approx(run[1] - run[0], abs=0.2)
    assert found["(not (open lab_door)) from 2026-05-04T09:10:00Z"][1:] == (WIDTH, Look.SCHEDULED_FALSE)
    assert all(right == now for _, right, style in facts if style == Look.TRUE)
    assert found["(open lab_door) since 2026-05-04T09:00:00Z"][0] < now


def test_long_labels_are_cut_and_further_lanes_counted():
    """Labels fit their margin, with the whole text in the tooltip; beyond some lanes the others are counted."""
    with kbstore.open("sqlite://", "many", clock=ManualClock(seconds(9))) as kb:
        kb.add(*(f"(p {'x' * 200}{number})" for number in range(MOST_LANES + 7)))
        for answer in (kb.history("(p ?)"), kb.state(), kb.diff(0, "now")):
            drawn = picture(answer)
            labels = [word for word in words(drawn) if word.startswith("(p ")]
            assert len(labels) == MOST_LANES
            assert max(map(len, labels)) <= LONGEST + 1
            assert "and 7 more" in words(drawn)
            tips = [each.text for each in drawn.iter(f"{SVG}title")]
            assert f"(p {'x' * 200}3)" in tips


def test_a_long_history_is_drawn_from_its_end():
    """Of thousands of assertions the latest are drawn, with the total number: a notebook stays small."""
    with kbstore.open("sqlite://", "long", clock=(clock := ManualClock(seconds(9)))) as kb:
        for value in range(MOST_BARS + 20):
            kb.add(f"(= (f) {value})")
            clock.advance(seconds(1))
        drawn = picture(kb.history("(f)"))
    assert len(bars(drawn)) == MOST_BARS
    assert f"the latest {MOST_BARS} of {MOST_BARS + 20}" in words(drawn)
    assert f"20 to {MOST_BARS + 19}" in words(drawn)


def test_hostile_names_are_text():
    """Names, clients and notes stay text; there is no script, and no element but those of the pictures."""
    with kbstore.open("sqlite://", NASTY, clock=ManualClock(5)) as kb:
        kb.add("(<img> <b>)", client=NASTY, note=NASTY)
        kb.add("(= (<i> x) 3)")
        for answer in (kb.history("(<img> ?)"), kb.history("(<i> ?)"), kb.state(), kb.diff(0, "now")):
            drawn = picture(answer)
            assert {each.tag for each in drawn.iter()} <= {
                f"{SVG}{name}" for name in ("svg", "g", "title", "line", "text")
            }
            assert "<script" not in answer._repr_html_()
        tips = [each.text for each in picture(kb.history("(<img> ?)")).iter(f"{SVG}title")]
        assert any(NASTY in tip for tip in tips)


def test_an_empty_answer_is_not_drawn(kenny):
    """Where there is nothing, there is no picture, and the table says so."""
    with kbstore.open("sqlite://", "empty", clock=ManualClock(5)) as kb:
        assert "<svg" not in kb.history("(p ?)")._repr_html_()
    assert "<svg" not in kenny.diff("now", "now")._repr_html_()


def test_a_single_time_is_drawn():
    """A history without a length yet is drawn all the same."""
    with kbstore.open("sqlite://", "short", clock=ManualClock(5)) as kb:
        kb.add("(p a)", "(= (f) 0)")
        assert len(bars(picture(kb.history()))) == 2
        assert len(bars(picture(kb.state()))) == 2
