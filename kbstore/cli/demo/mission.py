"""Eleven minutes of a porter robot, as recorded by its mission control, a door and a ward.

Kenny has to bring two parcels to the laboratory, whose door has opening hours. One parcel is withdrawn; then a fire
alarm closes the door while kenny is in front of it. Every number can be worked out by hand: driving costs a quarter of
a percent a second, at half a metre a second; charging adds half a percent a second.
"""

from pathlib import Path

import kbstore
from kbstore.clock import ManualClock, seconds
from kbstore.knowledge_base import KnowledgeBase
from kbstore.model.results import Run
from kbstore.names import bracketed

DOMAIN = Path(__file__).with_name("domain.pddl")
PROBLEM = Path(__file__).with_name("problem.pddl")

NAME = "kenny"
"""The name of the knowledge base."""


def moment(text: str) -> int:
    """Return a time of the mission's day in nanoseconds: ``moment("09:02:00")``."""
    return kbstore.time(f"2026-05-04T{text}Z")


START, END = moment("08:58:00"), moment("09:09:10")


class Mission:
    """Plays the mission: sets the clock, and records what happens."""

    def __init__(self, kb: KnowledgeBase, clock: ManualClock) -> None:
        self._kb = kb
        self._clock = clock

    def play(self) -> None:
        """Play all of it."""
        self._set_out()
        self._alarm()
        self._deliver()
        self._come_home()

    def _set_out(self) -> None:
        kb = self._kb
        kb.load(DOMAIN, PROBLEM, client="mission", note="the morning round; the lab door is open from 09:00 to 09:10")
        self._at("08:58:10")
        undocking = self._start("undock", "kenny", "home")
        self._at("08:58:20")
        self._end(undocking)
        self._drive("08:58:20", "home", "office", until="08:58:44")
        kb.apply("pick_up", "kenny", "blood", "office", client="mission", note="pick up the blood")
        self._at("08:59:10")
        kb.remove("linen - parcel", client="ward", note="the patient was moved; no linen today")
        self._drive("08:59:30", "office", "corridor", until="09:00:30")

    def _alarm(self) -> None:
        """Let the door shut while the robot passes it."""
        self._at("09:00:40")
        passing = self._start("pass_door", "kenny", "lab_door", "corridor", "lab")
        self._at("09:01:00")
        self._kb.add("(not (open lab_door))", client="fire alarm", note="all doors closed")
        self._at("09:01:02")
        self._kb.abort(passing, client="mission", note="the door shut in front of kenny")
        self._at("09:01:05")
        self._kb.add("(robot_at kenny corridor)", client="localisation", note="still in the corridor")
        self._at("09:04:00")
        with self._kb.transaction(client="facilities", note="all clear; the lab stays open until 09:15 instead") as tx:
            tx.add("(open lab_door)")
            tx.remove("(not (open lab_door))", initial_time=moment("09:10:00"))
            tx.add("(not (open lab_door))", initial_time=moment("09:15:00"))

    def _deliver(self) -> None:
        self._at("09:04:10")
        passing = self._start("pass_door", "kenny", "lab_door", "corridor", "lab")
        self._at("09:04:50")
        self._end(passing)
        self._at("09:05:00")
        self._kb.apply("hand_over", "kenny", "blood", "lab", client="mission", note="hand over the blood")

    def _come_home(self) -> None:
        self._at("09:05:10")
        passing = self._start("pass_door", "kenny", "lab_door", "lab", "corridor")
        self._at("09:05:50")
        self._end(passing)
        self._drive("09:06:00", "corridor", "home", until="09:06:48")
        self._at("09:06:50")
        docking = self._start("dock", "kenny", "home")
        self._at("09:07:00")
        self._end(docking)
        self._at("09:07:10")
        charging = self._start("charge", "kenny", duration=seconds(300))
        self._at("09:09:10")
        self._kb.abort(charging, client="mission", note="called away from the charger")

    # -- steps ------------------------------------------------------------------------------------------------

    def _at(self, text: str) -> None:
        self._clock.set(moment(text))

    def _drive(self, since: str, origin: str, target: str, *, until: str) -> None:
        self._at(since)
        run = self._start("drive", "kenny", origin, target)
        self._at(until)
        self._end(run)

    def _start(self, operator: str, *arguments: str, duration: int | None = None) -> Run:
        note = f"start {bracketed(operator, *arguments)}"
        return self._kb.start(operator, *arguments, duration=duration, client="mission", note=note)

    def _end(self, run: Run) -> None:
        self._kb.end(run, client="mission", note=f"end {run.action}")


def record(url: str) -> KnowledgeBase:
    """Record the mission in a store, and return the knowledge base, still open, at the end of the mission."""
    clock = ManualClock(START)
    kb = kbstore.open(url, NAME, clock=clock)
    Mission(kb, clock).play()
    return kb
