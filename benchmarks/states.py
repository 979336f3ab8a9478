"""The state at t, against fetching its rows raw.

Past states are cached, so each question here is about a nanosecond of its own.
"""

from collections.abc import Callable, Iterator
from itertools import count, cycle

import kbstore
from benchmarks.histories import SHAPES, START, STEP, History
from benchmarks.measuring import CPU, side_by_side
from benchmarks.raw import Answers
from benchmarks.report import Result
from benchmarks.settings import Settings
from kbstore import KnowledgeBase, ManualClock, State

BAR = 2.5


def measure(settings: Settings) -> Iterator[Result]:
    """Measure each shape at the worst of six times: the state, a question to it, all of it, and the same again."""
    for shape in SHAPES:
        history = History(shape, settings.size)
        path = settings.store(history)
        with kbstore.open(path, "bench", clock=ManualClock(START + history.size * STEP)) as kb:
            answers = Answers(settings.new("answers"), [kb.state(at=t) for t in history.moments()])
            worst: dict[str, tuple[float, float]] = {}
            for index, t in enumerate(history.moments()):
                found = side_by_side(_ways(kb, t, answers, index), clock=CPU, seconds=settings.seconds)
                for name, duration in found.items():
                    if name not in worst or duration / found["raw"] > worst[name][0] / worst[name][1]:
                        worst[name] = (duration, found["raw"])
            for name, (ours, theirs) in worst.items():
                if name != "raw":
                    bar = None if name == _AGAIN else BAR
                    yield Result(f"{name}, {shape}, {settings.size:,}", "raw fetch of its rows", ours, theirs, bar)
            yield _unprepared(settings, kb, history, answers)


_LISTED = "state at t, all of it as messages"
_AGAIN = "state at t and one question, asked again"


def _ways(kb: KnowledgeBase, t: int, answers: Answers, index: int) -> dict[str, Callable[[], object]]:
    asked = kb.state(at=t).facts[500]
    # much less than a step: the rows are the same
    times = count(t)

    def listed() -> State:
        state = kb.state(at=next(times))
        _ = state.facts, state.instances
        return state

    return {
        "raw": lambda: answers.fetch(index),
        "state at t": lambda: kb.state(at=next(times)),
        "state at t and one question": lambda: kb.state(at=next(times)).holds(asked),
        _LISTED: listed,
        _AGAIN: lambda: kb.state(at=t).holds(asked),
    }


def _unprepared(settings: Settings, kb: KnowledgeBase, history: History, answers: Answers) -> Result:
    """Times that have not been asked about, whose timelines and pages are not in memory yet."""
    moments = history.moments()
    first, last = moments[0], moments[-1]
    turns = (first + turn + (last - first) * (index * 89 % 997) // 997 for turn, index in enumerate(cycle(range(997))))
    ways = {"raw": lambda: answers.fetch(3), "state": lambda: kb.state(at=next(turns))}
    found = side_by_side(ways, clock=CPU, seconds=settings.seconds)
    what = f"state at another t each time, {history.shape}, {history.size:,}"
    return Result(what, "raw fetch of its rows", found["state"], found["raw"])
