"""The pictures of the documentation: the two axes of time agree with the demonstration (rules Q1, Q2)."""

import re

from kbstore.cli.demo.mission import START, record
from kbstore.clock import SECOND
from tests.docs.blocks import ROOT

FILL = {"#cfe8d5": True, "#f3cdcd": False, "#eeeeee": False}
"""Whether the door is open, by the colour of an area."""

ORIGIN, MINUTE = (150, 390), 32
"""Where the mission begins, on both axes, and the length of a minute."""


def test_each_area_is_what_was_believed():
    """In the middle of each area, and a second within each of its edges."""
    picture = (ROOT / "docs" / "bitemporal.svg").read_text()
    areas = re.findall(r'<rect x="(\S+)" y="(\S+)" width="(\S+)" height="(\S+)" fill="(\S+)"', picture)
    assert len(areas) == 11

    def time(distance, beyond):
        return START + round(distance / MINUTE * 60 + beyond) * SECOND

    with record("sqlite://") as kb:
        for *numbers, fill in areas:
            x, y, width, height = map(float, numbers)
            left, bottom = x - ORIGIN[0], ORIGIN[1] - y - height
            for at in (time(left, 1), time(left + width / 2, 0), time(left + width, -1)):
                for as_of in (time(bottom, 1), time(bottom + height / 2, 0), time(bottom + height, -1)):
                    assert kb.holds("(open lab_door)", at=at, as_of=as_of) is FILL[fill], (at, as_of)


def test_the_picture_of_the_page_is_shown_and_small():
    """README and the timeline's own page show it; it is small enough for a clone and a web page."""
    assert "(docs/timeline.png)" in (ROOT / "README.md").read_text()
    assert "(timeline.png)" in (ROOT / "docs" / "timeline.md").read_text()
    picture = (ROOT / "docs" / "timeline.png").read_bytes()
    assert picture.startswith(b"\x89PNG")
    assert 20_000 < len(picture) < 200_000
