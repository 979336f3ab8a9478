"""Stories that are pushed, and comparisons of two copies."""

import io
import json
import random
import threading

import kbstore
from kbstore import KbStoreError, seconds
from tests.property.test_random_rates import DOMAIN as TANKS

MOVING = ("fill", "leak", "boost")


def export(url, name):
    """A whole knowledge base, as bytes."""
    output = io.BytesIO()
    kbstore.export_knowledge_base(url, name, output)
    return output.getvalue()


def rows(exported):
    """The rows of an export, without those that may differ while a copy is behind its source.

    Rows derived for later times are derived again there, under another key; flags of which kinds of rows there are, and
    which objects the metric mentions, may be set sooner.
    """
    head, *lines = [json.loads(line) for line in exported.splitlines()][:-1]
    ahead = {
        (row["recorded_tx"], row["seq"])
        for row in lines
        if row["table"] == "schedules" and row["is_derived"] and row["initial_time"] > head["last_time"]
    }
    found = [{name: value for name, value in head.items() if name not in ("check", "rows", "present")}]
    for row in lines:
        if row["table"] in ("mentions", "symbols"):
            continue
        is_derived = row["table"] in ("functions", "schedules") and (row["recorded_tx"], row["seq"]) in ahead
        hidden = ("check", "recorded_tx", "seq", "recorded_time") if is_derived else ("check",)
        found.append({name: value for name, value in row.items() if name not in hidden})
    return sorted(json.dumps(row, sort_keys=True) for row in found)


def live_with_tanks(kb, clock, seed, steps):
    """Make numbers follow what their rates read, schedules included (rule O5); yield after each step.

    Times and numbers are not round: derived rows have to be the same to the last bit.
    """
    chance = random.Random(seed)
    runs = {}
    kb.load(TANKS)
    kb.add("(= (level) 0.1)", "(= (inflow) 0.3)")
    for _ in range(steps):
        yield
        clock.advance(chance.choice((0, 1, 333_333_333, 700_000_001, 1_500_000_007)))
        later = clock.now() + chance.choice((100_000_003, 600_000_001, 1_234_567_891, 4_000_000_001))
        number, action = chance.choice((0.1, 0.7, -0.3, 2)), chance.choice(MOVING)
        try:
            match chance.randrange(9):
                case 0 | 1 | 2:
                    kb.add(f"(= (inflow) {number})", initial_time=chance.choice((0, later, later)))
                case 3:
                    kb.add(f"(= (level) {number})", initial_time=chance.choice((0, later)))
                case 4 if chance.random() < 0.6:
                    kb.add("(open)", initial_time=chance.choice((0, later)))
                case 4:
                    kb.remove("(open)")
                case 5:
                    for item in kb.timed_knowledge()[:1]:
                        kb.remove(item, initial_time=item.initial_time)
                case 6 | 7 if action not in runs:
                    runs[action] = kb.start(action, duration=seconds(chance.choice((1, 2, 5))))
                case _ if action in runs:
                    (kb.end if chance.random() < 0.6 else kb.abort)(runs.pop(action))
        except KbStoreError:
            # refused by a rule, as it would be anywhere
            continue


class following:
    """Run a following push in a thread, inside the block."""

    def __init__(self, kb, target, *arguments):
        self._kb = kb
        self._error = None
        self._thread = threading.Thread(target=self._run, args=(kb, target, *arguments))

    def _run(self, *arguments):
        try:
            kbstore.push(*arguments, follow=True)
        except kbstore.KbStoreError as error:
            self._error = error

    def __enter__(self):
        self._thread.start()

    def __exit__(self, *_):
        self._kb.close()
        self._thread.join(30)
        assert not self._thread.is_alive()
        assert self._error is None, self._error


def same(source, target, name):
    """Whether the copy equals the source already."""
    try:
        return export(target, name) == export(source, name)
    except kbstore.KbStoreError:
        return False
