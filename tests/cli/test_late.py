"""Late knowledge on the command line: ``--since`` and ``--until`` in writing, ``--as-of`` in questions."""

import pytest

DOOR, SHUT = "(open lab_door)", "(not (open lab_door))"
EIGHT, NINE, NOON = (f"2026-06-01T{hour}:00:00Z" for hour in ("08", "09", "12"))


@pytest.fixture
def lab(run, store):
    """A store with the lab door open since eight, recorded at eight, and shut since nine, recorded at noon."""

    def command(*arguments):
        return run("--url", store, *arguments)

    command("add", DOOR, "--now", EIGHT)
    command("add", SHUT, "--since", NINE, "--now", NOON, "--client", "porter")
    return command


def test_late_knowledge_holds_since_its_past_time(lab):
    """L1, L4: it was not known before; --as-of takes a time or a transaction."""
    ten = "2026-06-01T10:00:00Z"
    last = lab("changes", "--json").out.strip().splitlines()[-1]
    number = int(last.partition('"number": ')[2].partition(",")[0])
    assert lab("holds", DOOR, "--at", ten, "--now", NOON).code == 1
    assert lab("holds", DOOR, "--at", ten, "--as-of", ten, "--now", NOON).code == 0
    assert lab("holds", DOOR, "--at", ten, "--as-of", f"tx{number - 1}", "--now", NOON).code == 0
    assert lab("holds", DOOR, "--at", ten, "--as-of", f"tx{number}", "--now", NOON).code == 1
    assert lab("find", DOOR, "--at", ten, "--as-of", f"tx{number - 1}", "--now", NOON).code == 0
    assert lab("find", DOOR, "--at", ten, "--as-of", f"tx{number}", "--now", NOON).code == 1
    assert lab("runs", "--as-of", "tx1", "--now", NOON, "--json").json == []
    assert (
        lab("when", DOOR, "--since", EIGHT, "--now", NOON, "--json").out
        != lab("when", DOOR, "--since", EIGHT, "--now", NOON, "--as-of", ten, "--json").out
    )
    assert len(lab("history", DOOR, "--since", EIGHT, "--now", NOON, "--json").json) == 3
    assert len(lab("history", DOOR, "--since", EIGHT, "--now", NOON, "--as-of", ten, "--json").json) == 1


def test_a_span_of_the_past(lab):
    """L2, L3: --until ends it; after a removal the fact is absent in the span."""
    lab("add", DOOR, "--since", "2026-06-01T10:00:00Z", "--until", "2026-06-01T11:00:00Z", "--now", NOON)
    lab("remove", SHUT, "--since", "2026-06-01T11:30:00Z", "--now", NOON)
    spans = lab("when", DOOR, "--since", NINE, "--now", NOON, "--json").json
    assert [(span["start"], span["end"]) for span in spans] == [("2026-06-01T10:00:00Z", "2026-06-01T11:00:00Z")]
    last = lab("history", DOOR, "--since", NINE, "--now", NOON, "--json").json[-1]
    assert (last["pddl"], last["end_time"]) == (SHUT, "2026-06-01T11:30:00Z")


def test_invalid_spans_are_refused(lab):
    """L1: the error is one line, with exit 2."""
    done = lab("add", DOOR, "--since", "2026-06-01T13:00:00Z", "--now", NOON)
    assert (done.code, len(done.err.splitlines())) == (2, 1)
    assert "lies after now" in done.err
    done = lab("holds", DOOR, "--as-of", "tx999")
    assert (done.code, len(done.err.splitlines())) == (2, 1)
    assert "has no transaction 999" in done.err
