"""The record as MCAP, read back by mcap: states at their changes, numbers at their corners, runs."""

import errno
import json

import pytest
from mcap.reader import make_reader

import kbstore
from kbstore import seconds
from kbstore.clock import ManualClock
from kbstore.ros.bags.mcap_file import export_mcap

DOMAIN = """
(define (domain rooms)
  (:requirements :typing :fluents :durative-actions)
  (:types place robot)
  (:predicates (at ?r - robot ?p - place) (open ?p - place) (raining))
  (:functions (battery ?r - robot) (distance ?from ?to - place))
  (:durative-action go :parameters (?r - robot ?to - place) :duration (>= ?duration 1) :condition () :effect ())
  (:durative-action rest :parameters () :duration (>= ?duration 1) :condition () :effect ()))
"""


class Messages:
    """The messages of an MCAP file, by topic, as pairs of seconds and fields; times have to be whole here."""

    def __init__(self, path):
        self.by_topic, self.schemas, self.order = {}, {}, []
        with path.open("rb") as file:
            for schema, channel, message in make_reader(file).iter_messages(log_time_order=False):
                assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
                assert message.publish_time == message.log_time
                self.schemas[schema.name] = json.loads(schema.data)
                self.order.append(message.log_time)
                found = json.loads(message.data)
                assert set(found) <= set(self.schemas[schema.name]["properties"])
                self.by_topic.setdefault(channel.topic, []).append((message.log_time, schema.name, found))

    def of(self, topic, field="value"):
        return [(t / 10**9, found.get(field)) for t, _, found in self.by_topic[topic]]


@pytest.fixture
def clock():
    return ManualClock(seconds(10))


@pytest.fixture
def kb(clock):
    with kbstore.open("sqlite://", "kenny", clock=clock) as kb:
        kb.load(DOMAIN, client="operator", note="a start")
        kb.add("kenny - robot", "hall - place", "lab - place", client="mapper")
        yield kb


@pytest.fixture
def exported(kb, tmp_path):
    def exporting(**options):
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}.mcap"
        done = export_mcap(kb, path, **options)
        found = Messages(path)
        assert done.messages == len(found.order)
        assert done.topics == len(found.by_topic)
        assert found.order == sorted(found.order)
        return found

    return exporting


def test_a_topic_for_a_predicate_and_an_object(kb, clock, exported):
    """Its value is the place of kenny: the other arguments of its facts, empty for none, all of several.

    Panels draw a state up to the next message: the last is repeated at the end.
    """
    kb.add("(at kenny hall)", "(open hall)", "(raining)")
    clock.set(seconds(20))
    kb.remove("(at kenny hall)", "(raining)")
    clock.set(seconds(30))
    kb.add("(at kenny lab)", "(not (open hall))")
    clock.set(seconds(40))
    kb.add("(at kenny hall)")
    found = exported()
    assert found.of("/facts/at/kenny") == [(10, "hall"), (20, ""), (30, "lab"), (40, "lab, hall")]
    assert found.of("/facts/at/kenny", "facts")[-1] == (40, ["(at kenny lab)", "(at kenny hall)"])
    assert found.of("/facts/open/hall") == [(10, "true"), (30, "false"), (40, "false")]
    assert found.of("/facts/raining") == [(10, "true"), (20, ""), (40, "")]


def test_an_explicitly_false_fact_beside_a_true_one(kb, exported):
    """An explicitly false fact is marked in the value of the true one."""
    kb.add("(at kenny hall)", "(not (at kenny lab))")
    assert exported().of("/facts/at/kenny") == [(10, "hall, not lab")]


def test_numbers_at_their_corners(kb, clock, exported):
    """A number has its value where it begins and where it ends: twice where it jumps, and none once it is gone."""
    kb.add("(= (battery kenny) 80)", "(= (distance hall lab) 5)")
    kb.add("(increase (battery kenny) (* #t -0.5))")
    clock.set(seconds(20))
    kb.add("(= (battery kenny) 100)")
    clock.set(seconds(30))
    kb.remove("(battery kenny)")
    clock.set(seconds(40))
    kb.add("(open hall)")
    found = exported()
    assert found.of("/numbers/battery/kenny") == [(10, 80), (20, 75), (20, 100), (30, 100), (30, None)]
    assert found.of("/numbers/battery/kenny", "defined")[-2:] == [(30, True), (30, False)]
    # an open value is drawn to the end
    assert found.of("/numbers/distance/hall/lab") == [(10, 5), (40, 5)]


def test_runs_and_objects(kb, clock, exported):
    """A run is a value from its start to its end, with its outcome; an object has its type while it exists."""
    first = kb.start("go", "kenny", "lab", duration=seconds(30))
    second = kb.start("go", "kenny", "hall", duration=seconds(30))
    kb.start("rest", duration=seconds(30))
    clock.set(seconds(20))
    kb.end(first)
    clock.set(seconds(25))
    kb.abort(second)
    kb.remove("hall - place")
    found = exported()
    assert found.of("/runs/go/kenny") == [(10, "lab, hall"), (20, "hall"), (25, "")]
    assert found.of("/runs/go/kenny", "outcome") == [(10, "running"), (20, "running"), (25, "aborted")]
    assert found.of("/runs/go/kenny", "action")[-1] == (25, "(go kenny hall)")
    assert found.of("/runs/go/kenny", "ended_by")[-1] == (25, 7)
    assert found.of("/runs/rest") == [(10, "running"), (25, "running")]
    assert found.of("/objects/hall") == [(10, "place"), (25, "")]
    assert found.of("/objects/hall", "exists") == [(10, True), (25, False)]


def test_transactions(kb, exported):
    """Client and note of each."""
    found = exported()
    assert found.of("/transactions") == [(10, 1), (10, 2)]
    assert found.of("/transactions", "client") == [(10, "operator"), (10, "mapper")]
    assert found.of("/transactions", "note") == [(10, "a start"), (10, "")]


def test_a_span(kb, clock, exported):
    """The state at the begin is written for that time, with the values of then; nothing is after the end."""
    kb.add("(at kenny hall)", "(= (battery kenny) 80)")
    kb.add("(increase (battery kenny) (* #t 2))")
    clock.set(seconds(40))
    kb.remove("(at kenny hall)")
    found = exported(since=seconds(20), until=seconds(30))
    assert found.of("/facts/at/kenny") == [(20, "hall"), (30, "hall")]
    assert found.of("/numbers/battery/kenny") == [(20, 100), (30, 120)]
    assert "/transactions" not in found.by_topic


def test_as_of(kb, clock, exported):
    """The record as of then; cancelled and superseded assertions are left out."""
    first = kb.add("(at kenny hall)")
    kb.add("(at kenny lab)", initial_time=seconds(50))
    kb.remove("(at kenny lab)", initial_time=seconds(50))
    clock.set(seconds(40))
    kb.add("(not (at kenny hall))", since=seconds(20), until=seconds(30))
    assert exported().of("/facts/at/kenny") == [(10, "hall"), (20, "not hall"), (30, "hall"), (40, "hall")]
    assert exported(as_of=first).of("/facts/at/kenny") == [(10, "hall")]


def test_nanoseconds(kb, clock, tmp_path):
    """Times are exact."""
    clock.set(1_700_000_000_123_456_789)
    kb.add("(open lab)")
    export_mcap(kb, tmp_path / "kenny.mcap")
    assert Messages(tmp_path / "kenny.mcap").by_topic["/facts/open/lab"][0][0] == 1_700_000_000_123_456_789


def test_an_existing_file_is_kept(kb, tmp_path):
    """It is not overwritten."""
    path = tmp_path / "kenny.mcap"
    path.write_text("mine")
    with pytest.raises(kbstore.InvalidKnowledge, match=r"kenny.mcap exists, and is not overwritten"):
        export_mcap(kb, path)
    assert path.read_text() == "mine"


def test_an_incomplete_file_is_removed(kb, tmp_path, monkeypatch):
    """Where the disk is full, no file is left."""

    def full(self):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("kbstore.ros.bags.mcap_file.Writer.finish", full)
    with pytest.raises(
        kbstore.StoreUnavailable, match=r"kenny.mcap: No space left on device; nothing has been written"
    ):
        export_mcap(kb, tmp_path / "kenny.mcap")
    assert list(tmp_path.iterdir()) == []


def test_an_empty_span(kb, tmp_path):
    """A file without messages can be read."""
    done = export_mcap(kb, tmp_path / "kenny.mcap", since=1, until=2)
    assert (done.messages, done.topics, done.since, done.until) == (0, 0, None, None)
    assert Messages(tmp_path / "kenny.mcap").order == []
