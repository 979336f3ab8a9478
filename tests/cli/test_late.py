"""Late knowledge on the command line: ``--since`` and ``--until`` in writing, ``--as-of`` in questions."""

import pytest

DOOR, SHUT = "(open lab_door)", "(not (open lab_door))"
EIGHT, NINE, NOON = (f"2026-06-01T{hour}:00:00Z" for hour in ("08", "09", "12"))


@pytest.fixture
def told(run, store):
    """A store in which the door is open since eight, told at eight, and shut since nine, told at noon."""

    def telling(*arguments):
        return run("--url", store, *arguments)

    telling("add", DOOR, "--now", EIGHT)
    telling("add", SHUT, "--since", NINE, "--now", NOON, "--client", "porter")
    return telling


def test_what_is_told_late_holds_since_then(told):
    """L1, L4: and was not known before; --as-of takes a time or a transaction."""
    ten = "2026-06-01T10:00:00Z"
    last = told("changes", "--json").out.strip().splitlines()[-1]
    number = int(last.partition('"number": ')[2].partition(",")[0])
    assert told("holds", DOOR, "--at", ten, "--now", NOON).code == 1
    assert told("holds", DOOR, "--at", ten, "--as-of", ten, "--now", NOON).code == 0
    assert told("holds", DOOR, "--at", ten, "--as-of", f"tx{number - 1}", "--now", NOON).code == 0
    assert told("holds", DOOR, "--at", ten, "--as-of", f"tx{number}", "--now", NOON).code == 1
    assert told("find", DOOR, "--at", ten, "--as-of", f"tx{number - 1}", "--now", NOON).code == 0
    assert told("find", DOOR, "--at", ten, "--as-of", f"tx{number}", "--now", NOON).code == 1
    assert told("runs", "--as-of", "tx1", "--now", NOON, "--json").json == []
    assert (
        told("when", DOOR, "--since", EIGHT, "--now", NOON, "--json").out
        != told("when", DOOR, "--since", EIGHT, "--now", NOON, "--as-of", ten, "--json").out
    )
    assert len(told("history", DOOR, "--since", EIGHT, "--now", NOON, "--json").json) == 3
    assert len(told("history", DOOR, "--since", EIGHT, "--now", NOON, "--as-of", ten, "--json").json) == 1


def test_a_span_of_the_past(told):
    """L2, L3: --until ends it; a removal leaves the span blank."""
    told("add", DOOR, "--since", "2026-06-01T10:00:00Z", "--until", "2026-06-01T11:00:00Z", "--now", NOON)
    told("remove", SHUT, "--since", "2026-06-01T11:30:00Z", "--now", NOON)
    spans = told("when", DOOR, "--since", NINE, "--now", NOON, "--json").json
    assert [(span["start"], span["end"]) for span in spans] == [("2026-06-01T10:00:00Z", "2026-06-01T11:00:00Z")]
    last = told("history", DOOR, "--since", NINE, "--now", NOON, "--json").json[-1]
    assert (last["pddl"], last["end_time"]) == (SHUT, "2026-06-01T11:30:00Z")


def test_what_is_refused(told):
    """L1: in one line, with exit 2."""
    done = told("add", DOOR, "--since", "2026-06-01T13:00:00Z", "--now", NOON)
    assert (done.code, len(done.err.splitlines())) == (2, 1)
    assert "lies after now" in done.err
    done = told("holds", DOOR, "--as-of", "tx999")
    assert (done.code, len(done.err.splitlines())) == (2, 1)
    assert "has no transaction 999" in done.err
