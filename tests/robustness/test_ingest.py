"""Ingesting more than fits into memory: batches, totals, errors that name the item, constant memory.

With KBSTORE_TEST_FULL=1 the memory is measured over a million items.
"""

import gc
import itertools
import tracemalloc

import pytest

import kbstore
from kbstore.errors import InvalidKnowledge, PddlSyntaxError, StoreUnavailable
from kbstore.messages import formulas
from tests.robustness.processes import FULL

DOMAIN = """
(define (domain readings)
  (:requirements :typing :fluents)
  (:types sensor)
  (:predicates (seen ?s - sensor))
  (:functions (reading ?s - sensor)))
"""


@pytest.fixture
def readings(open_kb):
    """A knowledge base with a domain, and two sensors."""
    kb = open_kb()
    kb.load(DOMAIN)
    kb.add("s0 - sensor", "s1 - sensor")
    return kb


def test_all_items_are_added(readings):
    """Texts, mappings and messages from an iterator are added as by `add`, in one transaction for each batch."""
    items = itertools.chain(
        ("s2 - sensor", {"knowledge_type": 1, "attribute_name": "seen", "values": [{"key": "s", "value": "s2"}]}),
        (kbstore.Function(attribute_name="reading", values=["s0"], function_value=value) for value in range(7)),
    )
    reported = []
    done = readings.ingest(items, batch=4, client="logger", note="old log", progress=reported.append)
    assert reported == [4, 8, 9]
    assert (done.items, done.batches, done.number, done.client, done.note) == (9, 3, 5, "logger", "old log")
    changes = list(readings.changes(after=2))
    assert [change.transaction.changes for change in changes] == [3, 1, 1]
    assert done.changes == 5
    assert {change.transaction.client for change in changes} == {"logger"}
    assert readings.holds("(seen s2)")
    assert readings.value("(reading s0)") == 6


def test_ingest_returns_its_last_transaction(readings, clock):
    """The result is the last transaction, which `as_of` takes, too."""
    done = readings.ingest(["(seen s0)", "(seen s1)"], batch=1)
    clock.advance(5)
    readings.remove("(seen s0)")
    assert isinstance(done, kbstore.Transaction)
    assert {str(fact) for fact in readings.state(at=done.time, as_of=done).facts} == {"(seen s0)", "(seen s1)"}


def test_items_that_change_nothing(readings):
    """C1: no item, or no change, takes no number; the result has the latest one, and no changes."""
    done = readings.ingest([])
    assert (done.number, done.items, done.batches, done.changes) == (2, 0, 0, 0)
    done = readings.ingest(iter(["s0 - sensor"]), batch=1)
    assert (done.number, done.items, done.batches, done.changes) == (2, 1, 0, 0)


def test_scheduled_items_keep_their_time(readings, clock):
    """T4: an item with an initial time after now is scheduled, as by `add`."""
    later = clock.now() + 10
    readings.ingest([kbstore.Fact(attribute_name="seen", values=["s0"], initial_time=later)])
    assert not readings.holds("(seen s0)")
    assert readings.holds("(seen s0)", at=later)


def test_violations_name_the_item(readings):
    """D1: all violations of the batch, each with the number of its item; earlier batches are stored."""
    items = ["(seen s0)", "(= (reading s0) 1)", "(seen s1)", "(flying s0)", "(seen s9)", "(seen s1)", "(seen s0)"]
    reported = []
    with pytest.raises(InvalidKnowledge) as refusal:
        readings.ingest(iter(items), batch=3, progress=reported.append)
    first, second, kept = refusal.value.violations
    assert first.startswith("item 4: (flying s0)")
    assert second.startswith("item 5: (seen s9)")
    assert kept == "nothing from item 4 on was stored, the 3 items before were"
    assert reported == [3]
    assert {str(fact) for fact in readings.state().facts} == {"(seen s0)", "(seen s1)"}
    assert [change.number for change in readings.changes()] == [1, 2, 3]


def test_many_violations_are_not_all_listed(readings):
    """Of a batch with very many violations, no more are listed than a person reads."""
    with pytest.raises(InvalidKnowledge) as refusal:
        readings.ingest(f"(flying s{number})" for number in range(1000))
    assert len(refusal.value.violations) == 22
    assert refusal.value.violations[-2:] == (
        "and 980 more in this batch",
        "nothing from item 1 on was stored, the 0 items before were",
    )


def test_a_syntax_error_names_the_item(readings):
    """Text that is not PDDL is refused with its item's number, and the position in the text."""
    with pytest.raises(PddlSyntaxError, match=r"^item 3 \(nothing from item 3 on .*\): line 1, column") as refusal:
        readings.ingest(["(seen s0)", "(seen s1)", "(seen s0"], batch=2)
    assert (refusal.value.line, refusal.value.source) == (1, None)
    assert readings.holds("(seen s1)")


def test_an_iterator_that_fails(readings):
    """The iterator's exception is raised unchanged; earlier batches are stored, the batch in which it failed is not."""

    def items():
        yield from ("(seen s0)", "(seen s1)", "(= (reading s0) 1)")
        raise RuntimeError("the log ends here")

    with pytest.raises(RuntimeError, match="the log ends here"):
        readings.ingest(items(), batch=2)
    assert {str(fact) for fact in readings.state().facts} == {"(seen s0)", "(seen s1)"}
    assert readings.functions() == []


def test_the_iterator_may_ask_the_knowledge_base(readings):
    """Between batches no transaction is open: an iterator may ask and write."""
    seen = []

    def items():
        for number in range(4):
            readings.add(f"n{number} - sensor")
            seen.append(len(readings.state().facts))
            yield f"(seen n{number})"

    assert readings.ingest(items(), batch=2).items == 4
    assert seen == [0, 0, 2, 2]


@pytest.mark.parametrize("one", ["(seen s0)", b"(seen s0)", {"knowledge_type": 1}])
def test_one_item_is_not_an_iterable_of_items(readings, one):
    """A text or a mapping is one item, although Python can iterate over it."""
    with pytest.raises(InvalidKnowledge, match="is one item; ingest takes an iterable"):
        readings.ingest(one)


def test_an_empty_batch_size_is_refused(readings):
    """A batch of no items would never end."""
    with pytest.raises(ValueError, match="at least one item"):
        readings.ingest(["(seen s0)"], batch=0)


def test_where_writing_is_refused(readings, tmp_path):
    """A store that is read-only or closed refuses before the iterator is used."""
    items = iter(["(seen s0)"])
    path = tmp_path / "store.db"
    kbstore.open(path).close()
    with kbstore.open(path, read_only=True) as reader, pytest.raises(StoreUnavailable, match="read_only"):
        reader.ingest(items)
    readings.close()
    with pytest.raises(StoreUnavailable, match="closed"):
        readings.ingest(items)
    assert list(items) == ["(seen s0)"]


def test_memory_does_not_grow(tmp_path):
    """Ten times as many items, on as many new timelines, take no more memory than one tenth of them."""
    size = 100_000 if FULL else 400
    batch = size // 4
    with kbstore.open(tmp_path / "store.db", durability="normal") as kb:
        kb.ingest((f"(seen o{number})" for number in range(batch)), batch=batch)
        peaks = []
        # garbage collection must not depend on what other tests have left in memory
        gc.collect()
        gc.freeze()
        tracemalloc.start()
        try:
            # the cache of names has a limit, which is reached beforehand
            for number in range(formulas.KNOWN_VALUES):
                kbstore.item(f"(seen o{-number})")
            for part in (1, 10):
                numbers = range(part * 10**7, part * 10**7 + part * size)
                before, _ = tracemalloc.get_traced_memory()
                tracemalloc.reset_peak()
                kb.ingest((f"(seen o{number})" for number in numbers), batch=batch)
                held, peak = tracemalloc.get_traced_memory()
                peaks.append(peak - before)
                assert held - before < peaks[-1] / 2
        finally:
            tracemalloc.stop()
        assert peaks[1] < 1.3 * peaks[0]


def test_a_transaction_leaves_nothing_to_the_garbage_collector():
    """The memory of a transaction is freed when it ends: a batch does not wait for the garbage collector."""
    with kbstore.open("sqlite://") as kb:
        kb.add("(seen a)")
        gc.collect()
        gc.disable()
        try:
            kb.add("(seen b)", "(seen c)")
            gc.set_debug(gc.DEBUG_SAVEALL)
            gc.collect()
            left = sorted(
                {type(found).__name__ for found in gc.garbage if type(found).__module__.startswith("kbstore.")}
            )
        finally:
            gc.set_debug(0)
            gc.garbage.clear()
            gc.enable()
    assert left == []
