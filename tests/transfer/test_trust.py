"""An import trusts nothing: rows that no store could have written are refused, and those of any store are taken."""

import io
import random
import re
from contextlib import suppress

import pytest

import kbstore
from kbstore import HistoryUnavailable, InvalidKnowledge, InvalidTime, KbStoreError, ManualClock, seconds
from kbstore.transfer.scratch import Scratch
from tests.storage import test_invariants as rooms
from tests.storage.invariants import violations
from tests.transfer import random_histories as yard
from tests.transfer.mutations import mutated, sealed, unsealed


def exported(url, name):
    """A knowledge base as its export."""
    output = io.BytesIO()
    kbstore.export_knowledge_base(url, name, output)
    return output.getvalue()


def lived(path, seed):
    """A random story in a store, mostly with late knowledge, now and then archived; the archive's path, if any."""
    chance = random.Random(seed)
    clock = ManualClock(yard.START if seed % 2 else rooms.START)
    archive = path.with_suffix(".archive")
    with kbstore.open(path, "lived", clock=clock, durability="normal", use_unknowns=seed % 5 == 0) as kb:
        if seed % 2:
            for _ in yard.live(kb, clock, seed, chance.randrange(5, 40), late=seed % 3 > 0):
                pass
        else:
            rooms.play(kb, clock, rooms.sequences(chance.choice))
        if seed % 4 > 1:
            with suppress(HistoryUnavailable, InvalidTime):
                kb.archive(clock.now() - seconds(chance.choice((0, 1, 3, 9))), archive)
    return archive if archive.exists() else None


def test_each_row_is_checked_by_an_index(tmp_path, monkeypatch):
    """No check scans the knowledge base for each of its rows: 200,000 timelines would take an hour."""
    plans = []
    rows = Scratch.rows

    def explained(scratch, statement, **parameters):
        plan = scratch.connection.driver.execute(f"EXPLAIN QUERY PLAN {statement.sqlite}", {"kb": 1, **parameters})
        plans.extend(line[3] for line in plan)
        return rows(scratch, statement, **parameters)

    with kbstore.open(tmp_path / "store.db", "large") as kb:
        kb.add(*(f"r{number} - robot" for number in range(300)), *(f"(at r{number})" for number in range(300)))
    text = exported(tmp_path / "store.db", "large")
    monkeypatch.setattr(Scratch, "rows", explained)
    kbstore.import_knowledge_base(tmp_path / "copy.db", io.BytesIO(text))
    within = [line for line in plans if line.startswith("SEARCH other USING")]
    assert len(within) > 10
    assert [line for line in within if line.count("=?") < 2] == []


@pytest.mark.parametrize("seed", [21, 22, 23, 26, 27])
def test_every_export_can_be_imported(seed, tmp_path):
    """Also with late knowledge, runs and schedules, after archiving, and of an archive: byte for byte."""
    path = tmp_path / "store.db"
    for source in filter(None, (path, lived(path, seed))):
        text = exported(source, "lived")
        copy = tmp_path / f"{source.name}.copy"
        kbstore.import_knowledge_base(copy, io.BytesIO(text))
        assert exported(copy, "lived") == text


@pytest.mark.parametrize("seed", [31, 32, 34])
def test_a_mutation_is_refused_or_harmless(seed, tmp_path):
    """An export with a changed field and valid checksums is refused with its line, or the store is sound.

    A sound store could have been written: its tables have no contradiction, it answers, and it can be written to.
    """
    path = tmp_path / "store.db"
    lived(path, seed)
    lines = unsealed(exported(path, "lived"))
    chance = random.Random(seed)
    refused = taken = 0
    for attempt in range(16):
        changed, what = mutated(lines, chance)
        copy = tmp_path / f"{attempt}.db"
        sentence = imported(copy, sealed(changed))
        refused += sentence is not None
        taken += sentence is None
        if sentence is None:
            assert harmless(copy, changed[0]), what
        else:
            assert re.search(r": line \d+ .*; nothing has been imported; export the knowledge base again", sentence), (
                what
            )
            assert not copy.exists() or kbstore.knowledge_bases(copy) == [], what
    assert refused > taken


def imported(path, text):
    """None where an import succeeds, else the refusal, which is one line."""
    try:
        kbstore.import_knowledge_base(path, io.BytesIO(text), "changed")
    except InvalidKnowledge as error:
        return str(error)
    return None


def harmless(path, header):
    """Whether an imported store is sound."""
    allowed = ("the head is not at the last transaction's time", "the head does not list what is present")
    with kbstore.open(path, "changed", clock=ManualClock(header["last_time"] + seconds(100))) as kb:
        found = [] if header["history_from"] else violations(*rooms.reading(kb))
        with suppress(KbStoreError):
            yard.answers(kb, header["history_from"], header["last_time"])
        kb.state()
        kb.clear()
        kb.add("new - robot", "(= (battery new) 1)")
        # during a run, a number may become undefined by what its rate reads
        found = [one for one in found if not (header["rows"]["runs"] and re.match("functions .* should end at", one))]
        return not [one for one in found if not one.startswith(allowed)]


# -- contradictions -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def story(tmp_path_factory):
    """The lines of a story with a row of each kind: scheduled, cancelled, emptied, superseded, ended, run."""
    path = tmp_path_factory.mktemp("trust") / "story.db"
    clock = ManualClock(yard.START)
    with kbstore.open(path, "story", clock=clock) as kb:
        kb.add("(was)")
        clock.advance(1)
        kb.remove("(was)")
        kb.load(yard.DOMAIN)
        kb.add("a - place", "b - room", "r - robot", "(= (cost) 0)", "(= (battery r) 50)")
        kb.add("(open a)", "(near r a)", client="mapper")
        kb.add("(lit)", initial_time=yard.START + seconds(50))
        kb.add("(not (lit))", initial_time=yard.START + seconds(60))
        kb.remove("(not (lit))", initial_time=yard.START + seconds(60))
        kb.add("(open b)")
        kb.remove("(open b)")
        clock.advance(seconds(5))
        kb.start("work", "r", "a", duration=seconds(9))
        kb.add_goal("(> (cost) 3)", "(open b)")
        kb.add_metric("minimize (cost)")
        kb.remove("(near r a)")
        clock.advance(seconds(5))
        kb.add("(not (open a))", since=yard.START + seconds(2), until=yard.START + seconds(4))
        assert violations(*rooms.reading(kb)) == []
    return unsealed(exported(path, "story"))


def refusal(lines):
    """The sentence with which lines are refused, with the number of the line first."""
    with pytest.raises(InvalidKnowledge) as refused:
        kbstore.import_knowledge_base("sqlite://", io.BytesIO(sealed(lines)))
    sentence = str(refused.value)
    return sentence[sentence.index(": line ") + len(": line ") : sentence.index("; nothing has been imported")]


def one(lines, table, **wanted):
    """The number of the first row of a table that has some values; `None` is an absent column."""
    return next(
        number
        for number, line in enumerate(lines)
        if line.get("table") == table and all(line.get(name) == value for name, value in wanted.items())
    )


CHANGES = {
    "an object with a name that is no name": ("timelines", {"key": "a"}, {"key": "a(b"}, "has the name 'a\\(b', which"),
    "a control character in a name": ("timelines", {"key": "a"}, {"key": "a\x1b"}, "has the name"),
    "two timelines of one thing": ("timelines", {"key": "b"}, {"key": "a"}, "is a timeline that an earlier line has"),
    "a gap among timelines": ("timelines", {"id": 3}, {"id": 40}, "3 is expected"),
    "a goal that is a number": ("timelines", {"key": "cost"}, {"role": 1}, "has a role that its knowledge type"),
    "a goal that cannot be read": ("timelines", {"key": "(> (cost) 3)"}, {"key": "(> (cost"}, "condition that cannot"),
    "no mention": ("timelines", {"key": "near r a"}, {"key": "near r b"}, "mentions other objects than the lines"),
    "a domain that is none": ("domains", {}, {"source": "(define"}, "has a domain that cannot be read: line 1"),
    "a domain of another name": ("domains", {}, {"name": "garden"}, "has a domain of another name than 'garden'"),
    "a sensed predicate that is none": ("domains", {}, {"sensed": '["foo"]'}, "has no .* foo"),
    "a domain of another time": ("domains", {}, {"initial_time": 5}, "has another time than its transaction"),
    "a symbol of another arity": ("symbols", {"key": "was"}, {"arity": 1}, "was was first used with|was .*argument"),
    "a symbol that PDDL means otherwise": ("symbols", {"key": "was"}, {"key": "and", "name": "and"}, "PDDL text"),
    "labels that are too many": ("symbols", {"key": "was"}, {"labels": "x y"}, "which are not 0 different ones"),
    "a gap among transactions": ("transactions", {"number": 4}, {"number": 400}, "is transaction 400"),
    "a transaction before the one before": ("transactions", {"number": 9}, {"recorded_time": 5}, "has the time 5"),
    "two transactions of one token": ("transactions", {"number": 3}, {"token": "that of 2"}, "of another transaction"),
    "a last transaction that line 1 does not know": (
        "transactions",
        {"number": -1},
        {"token": 7},
        "and not what line 1",
    ),
    "late knowledge from later on": (
        "transactions",
        {"client": "", "number": -1},
        {"late_from": "+1"},
        "what is left of it before",
    ),
    "late knowledge that was never recorded": (
        "transactions",
        {"number": -1},
        {"late_from": None},
        "whose last late knowledge",
    ),
    "another type than the domain has": (
        "instances",
        {},
        {"instance_type": "song"},
        "does not fit the domain: .* song",
    ),
    "a type that does not fit": (
        "instances",
        {"instance_type": "robot"},
        {"instance_type": "room"},
        "robot is expected",
    ),
    "an end before the begin": ("facts", {"end_cause": 1}, {"end_time": 5}, "ends before it begins"),
    "an end of no length": ("facts", {"retired_tx": None}, {"end_time": "begin"}, "has no length and is not retired"),
    "an end that nothing makes": (
        "facts",
        {"retired_tx": None, "end_cause": None},
        {"end_time": "+1"},
        "nothing makes",
    ),
    "an end without a cause": ("facts", {"end_cause": 1}, {"end_cause": None}, "has ended_tx without end_cause"),
    "an end of another time": (
        "facts",
        {"end_cause": 1, "retired_tx": None},
        {"end_time": "+1"},
        "ends at another time",
    ),
    "a retired row without a revision": (
        "facts",
        {"retired_tx": None},
        {"retired_tx": 9, "end_time": 5},
        "ends before",
    ),
    "a row that was never recorded": (
        "facts",
        {"told_tx": 5, "end_time": None},
        {"told_tx": 4},
        "recorded nothing on its timeline",
    ),
    "a scheduled row without a schedule": ("schedules", {}, None, "has no line in schedules"),
    "a schedule of another time": ("schedules", {}, {"until_time": 5}, "contradicts its line in schedules"),
    "a schedule for no row": ("schedules", {}, {"seq": 77}, "has no line in schedules"),
    "a fact that is derived": ("schedules", {}, {"is_derived": True}, "which only a function can be"),
    "a revision that is missing": ("revisions", {"what": 2}, None, "has no line in revisions"),
    "a revision that contradicts its row": ("revisions", {"what": 1}, {"what": 3}, "retires a row otherwise"),
    "a revision with another end": ("revisions", {"what": 2}, {"end_before": 10**15}, "where its row has the end"),
    "a rate that no run adds": ("functions", {"own_rate": 0.0}, {"rate": 0.5}, "moves at a rate that no run adds"),
    "a negative number": ("functions", {}, {"is_negative": True}, "is negative, which it cannot be"),
    "a metric that cannot be read": ("expressions", {}, {"expr": "(cost"}, "has a text that cannot be read"),
    "a metric that is none": ("expressions", {}, {"optimization": "ignore"}, "is not a metric"),
    "a goal that is another": ("inequalities", {}, {"rhs": "4"}, "which is not what its timeline is about"),
    "a run of no action": ("runs", {}, {"operator": "sing"}, "is of an action that the domain does not have"),
    "a run with too many objects": ("runs", {}, {"arguments": "r a b"}, "which is not a durative action"),
    "a run with another duration": ("runs", {}, {"duration_s": 1.0}, "has a duration that is not duration_s"),
    "a run that ended without a time": (
        "runs",
        {},
        {"outcome": "ended"},
        "has not all of ended_tx, end_time and outcome",
    ),
    "a run of another time": ("runs", {}, {"initial_time": 5}, "starts at another time than its transaction's"),
    "a number that PostgreSQL cannot hold": ("transactions", {}, {"changes": 2**31}, "a whole number up to 2147483647"),
    "a column that is not known": ("facts", {}, {"colour": "red"}, "has 'colour', which a row of facts has not"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_contradictions_are_refused(story, name):
    """Lines that no store could have written are refused with their number, even with valid checksums."""
    table, wanted, values, problem = CHANGES[name]
    lines = [dict(line) for line in story]
    if wanted.get("number") == -1:
        wanted = wanted | {"number": lines[0]["last_number"]}
    number = one(lines, table, **wanted)
    if values is None:
        lines[0]["rows"] = lines[0]["rows"] | {table: lines[0]["rows"][table] - 1}
        lines[-1] = {"end": lines[-1]["end"] - 1}
        del lines[number]
    else:
        line = lines[number]
        for column, value in values.items():
            was = line.get(column, line.get("initial_time"))
            line[column] = {"+1": was, "begin": line.get("initial_time")}.get(value, value)
            if value == "+1":
                line[column] += 1
            elif value == "that of 2":
                line[column] = lines[one(lines, "transactions", number=2)][column]
            if value is None:
                del line[column]
    assert_matches(refusal(lines), problem)


def assert_matches(sentence, problem):
    """Check that a sentence begins with the number of a line, and has the expected words."""
    assert re.match(r"\d+ ", sentence), sentence
    assert re.search(problem, sentence), sentence


def test_the_line_is_that_of_the_row(story):
    """The refusal names the wrong line: the changed one, or one that it contradicts."""
    lines = [dict(line) for line in story]
    number = one(lines, "facts", end_cause=1, retired_tx=None)
    lines[number]["end_time"] += 1
    assert refusal(lines).startswith(f"{number + 1} ends at another time")


def test_a_wrong_header_is_refused(story):
    """A header that contradicts the rows is refused."""
    for column, value, problem in (
        ("present", 0, "which follows|follows from the numbers"),
        ("present", 64 + 63, "follows from the numbers"),
        ("last_number", 400, "whose last transaction"),
        ("last_late", 0, "whose last late knowledge"),
        ("last_timeline", 3, "up to the last_timeline"),
        ("last_token", 3, "not what line 1 says"),
        ("domain_version", 4, "versions of the domain"),
        ("last_run", 0, "after the last one of line 1"),
        ("history_from", 2**62, "is not a header"),
        ("name", "\x1b[2J", "cannot be the name of a knowledge base"),
    ):
        lines = [dict(line) for line in story]
        lines[0][column] = value
        with pytest.raises(InvalidKnowledge, match=problem):
            kbstore.import_knowledge_base("sqlite://", io.BytesIO(sealed(lines)))


def test_two_facts_at_one_time_are_refused(story):
    """Two rows of one timeline that hold at one time would leave no answer."""
    lines = [dict(line) for line in story]
    number = one(lines, "facts", retired_tx=None, end_time=None)
    other = next(
        place
        for place, line in enumerate(lines)
        if line.get("table") == "facts"
        and line["timeline_id"] != lines[number]["timeline_id"]
        and place > number
        and "retired_tx" not in line
    )
    lines[other]["timeline_id"] = lines[number]["timeline_id"]
    assert "holds until" in refusal(lines) or "contradicts its line" in refusal(lines)
