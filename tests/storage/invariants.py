"""The invariants of the tables of a store: read by plain SQL, and computed independently."""

from itertools import pairwise

from kbstore.clock import OPEN

TABLES = {"instances": 0, "facts": 1, "functions": 2, "expressions": 3, "inequalities": 4}
COLUMNS = (
    "recorded_tx, seq, timeline_id, initial_time, end_time, ended_tx, retired_tx, told_tx, level, end_cause,"
    " is_negative"
)
SCHEDULED = "recorded_tx, seq, knowledge_type, timeline_id, recorded_time, initial_time, until_time, node"

OPEN_LEVEL, EMPTY_LEVEL = 62, -64
CANCELLED, SUPERSEDED, EMPTIED, SETTLED, CUT_SHORT = range(1, 6)


def node(start, end):
    """The node of the interval tree for an interval: the shared leading bits of its two ends, a one, and zeros."""
    if end in (OPEN, start):
        return None
    first, last = format(start + 1, "063b"), format(end, "063b")
    parting = next((place for place in range(63) if first[place] != last[place]), 63)
    return end if parting == 63 else int(first[:parting] + "1" + "0" * (62 - parting), 2)


def level(start, end):
    """The number of zeros at the end of its node, which is all that a row stores of it.

    Open and empty intervals have levels of their own.
    """
    where = node(start, end)
    if where is None:
        return OPEN_LEVEL if end == OPEN else EMPTY_LEVEL
    return len(format(where, "b")) - len(format(where, "b").rstrip("0"))


class Row:
    """A row of one of the five tables."""

    def __init__(self, table, values):
        self.table = table
        for name, value in zip(COLUMNS.replace(" ", "").split(","), values, strict=True):
            setattr(self, name, value)
        self.key = (self.recorded_tx, self.seq)
        self.is_cancelled = self.retired_tx is not None and self.level == EMPTY_LEVEL and self.ended_tx is None
        self.is_emptied = self.retired_tx is not None and self.level == EMPTY_LEVEL and self.ended_tx is not None

    def __repr__(self):
        return f"{self.table} {self.key} [{self.initial_time}, {self.end_time})"


def violations(execute, kb):
    """The violated invariants in the tables of one knowledge base; `execute` runs SQL and returns the rows."""
    found = []

    def expect(condition, *what):
        if not condition:
            found.append(" ".join(map(str, what)))

    columns = "last_number, last_time, last_token, last_timeline, present"
    number, latest, token, last_timeline, present = execute(f"SELECT {columns} FROM heads WHERE kb_id = {kb}")[0]
    transactions = execute(f"SELECT number, recorded_time, token, last_timeline FROM transactions WHERE kb_id = {kb}")
    late = dict(execute(f"SELECT number, late_from FROM transactions WHERE kb_id = {kb} AND late_from IS NOT NULL"))
    last_late = execute(f"SELECT last_late FROM heads WHERE kb_id = {kb}")[0][0]
    expect(last_late == max(late, default=0), "the head does not know of the last late knowledge")
    times = {row[0]: row[1] for row in transactions}
    expect(sorted(times) == list(range(1, number + 1)), "numbers have gaps:", sorted(times), "last", number)
    expect(all(times[a] <= times[b] for a, b in pairwise(sorted(times))), "time runs backwards")
    expect(times.get(number, 0) == latest, "the head is not at the last transaction's time")
    if transactions:
        expect(max(transactions)[2:] == (token, last_timeline), "the head is not that of the last transaction")
    expect(len({row[2] for row in transactions}) == len(transactions), "tokens are not random")
    ids = sorted(row[0] for row in execute(f"SELECT id FROM timelines WHERE kb_id = {kb}"))
    expect(ids == list(range(1, last_timeline + 1)), "timelines have gaps", ids, "last", last_timeline)
    timelines = {
        row[0]: row[1:] for row in execute(f"SELECT id, role, knowledge_type, key FROM timelines WHERE kb_id = {kb}")
    }
    mentions = set(execute(f"SELECT object_id, timeline_id FROM mentions WHERE kb_id = {kb}"))
    objects = {key: id for id, (role, kind, key) in timelines.items() if (role, kind) == (0, 0)}
    by_timeline, empty, seqs = {}, {}, {}
    superseded, existed = set(), set()
    scheduled = {row[:2]: row[2:] for row in execute(f"SELECT {SCHEDULED} FROM schedules WHERE kb_id = {kb}")}
    derived = set(execute(f"SELECT recorded_tx, seq FROM schedules WHERE kb_id = {kb} AND is_derived"))
    revised = {}
    what = "tx, recorded_tx, seq, knowledge_type, what, end_before"
    for tx, *key, kind, change, end in execute(f"SELECT {what} FROM revisions WHERE kb_id = {kb} ORDER BY tx"):
        revised.setdefault(tuple(key), []).append((tx, kind, change, end))
    found_kinds = 0
    for table, kind in TABLES.items():
        for values in execute(f"SELECT {COLUMNS} FROM {table} WHERE kb_id = {kb}"):
            row = Row(table, values)
            found_kinds |= 1 << kind
            if row.key not in derived:
                # derived rows come last in their transaction, and may have been deleted
                seqs.setdefault(row.recorded_tx, []).append(row.seq)
            expect(row.key not in derived or table == "functions", row, "is derived")
            is_late = row.initial_time < times[row.recorded_tx]
            expect(not is_late or row.recorded_tx in late, row, "is late, but its transaction is not")
            expect(row.told_tx is None or (is_late and row.told_tx < row.recorded_tx), row, "was not recorded before")
            _check_row(row, times, is_late, expect)
            _check_schedule(row, kind, scheduled.pop(row.key, None), times, is_late, expect)
            _check_revisions(row, kind, revised.pop(row.key, ()), expect)
            if row.retired_tx is None:
                by_timeline.setdefault((table, row.timeline_id), []).append(row)
                continue
            superseded.add((table, row.timeline_id, row.initial_time))
            if table == "instances":
                existed.add((timelines[row.timeline_id][2], row.end_time))
            if row.is_emptied:
                empty.setdefault((table, row.timeline_id), []).append(row.initial_time)
    expect(not scheduled, "was scheduled and is not there:", scheduled)
    expect(not revised, "was revised and is not there:", revised)
    expect(present & 31 == found_kinds, "the head does not list what is present:", present, found_kinds)
    for recorded, found_seqs in seqs.items():
        expect(sorted(found_seqs) == list(range(len(found_seqs))), "places of", recorded, "have gaps", found_seqs)

    types = {
        row[:2]: row[2] for row in execute(f"SELECT recorded_tx, seq, instance_type FROM instances WHERE kb_id = {kb}")
    }
    existence_ends = {}
    for (table, timeline), rows in by_timeline.items():
        rows.sort(key=lambda row: row.initial_time)
        for before, after in pairwise(rows):
            expect(before.end_time <= after.initial_time, before, "overlaps", after)
        if table == "instances":
            existence_ends[timelines[timeline][2]] = _existence_ends(rows, types)
    for (table, timeline), rows in by_timeline.items():
        if table not in ("facts", "functions"):
            continue
        arguments = timelines[timeline][2].split(" ")[1:]
        for name in arguments:
            expect((objects.get(name), timeline) in mentions, timelines[timeline], "is not known to mention", name)
        for index, row in enumerate(rows):
            if row.ended_tx is None:
                ahead = [end for name in arguments for end in existence_ends.get(name, ()) if end > row.initial_time]
                ahead += [after.initial_time for after in rows[index + 1 : index + 2]]
                # an assertion that began and ended at one time has ended the one before it, too
                ahead += [t for t in empty.get((table, timeline), ()) if t > row.initial_time]
                end = min(ahead, default=OPEN)
                # late knowledge may have removed the assertion that ended it
                was = (table, timeline, row.end_time) in superseded or {(n, row.end_time) for n in arguments} & existed
                expect(row.end_time == end or (was and row.end_time < end), row, "should end at", end)
    for row in execute(
        f"SELECT number, initial_time, end_time, node, ended_tx, recorded_tx FROM runs WHERE kb_id = {kb}"
    ):
        _, start, end, kept, ended, recorded = row
        expect(kept == node(start, end), "run", row, "is kept at the wrong node")
        expect(start == times[recorded], "run", row, "starts when it is not recorded")
        expect(end == OPEN if ended is None else end == times[ended], "run", row, "ends at a wrong time")
    return found


def _check_row(row, times, is_late, expect):
    """The invariants of a single row, and of the transactions that touched it."""
    expect(row.initial_time <= row.end_time, row, "ends before it begins")
    expected = level(row.initial_time, row.end_time)
    if row.retired_tx is not None and expected != EMPTY_LEVEL:
        expected = -1 - expected
    expect(row.level == expected, row, "is kept on the wrong level", row.level)
    expect((row.end_time == row.initial_time) <= (row.retired_tx is not None), row, "has no length and counts")
    if row.is_cancelled:
        expect(times[row.retired_tx] < row.initial_time, row, "was cancelled too late")
    if row.is_emptied:
        expect(row.retired_tx == row.ended_tx, row, "was retired otherwise than by its end")
    expect((row.ended_tx is None) == (row.end_cause is None), row, "ended without a cause")
    if row.ended_tx is not None:
        # the part of a row that late knowledge has left ends in the past
        expect(is_late or row.end_time == times[row.ended_tx], row, "did not end with its transaction")
        expect(row.end_cause in (1, 2, 3, 4, 5), row, "ended for no known cause")


def _check_schedule(row, kind, scheduled, times, is_late, expect):
    """A row has one in `schedules` if it was recorded ahead of its time, and only then."""
    recorded = times[row.recorded_tx]
    if scheduled is None:
        expect(is_late or row.initial_time == recorded, row, "is not of its transaction's time", recorded)
        expect(not row.is_cancelled, row, "took effect and was cancelled")
        return
    until = times[row.retired_tx] if row.is_cancelled else row.initial_time
    expected = (kind, row.timeline_id, recorded, row.initial_time, until, node(recorded, until))
    expect(scheduled == expected, row, "was pending at the wrong node, or otherwise:", scheduled, expected)
    expect(recorded < row.initial_time, row, "was not scheduled ahead")


def _check_revisions(row, kind, revisions, expect):
    """The revisions of a row agree with its columns."""
    expect(all(found[1] == kind for found in revisions), row, "was revised as another kind")
    whats = [what for _, _, what, _ in revisions]
    is_superseded = row.retired_tx is not None and not row.is_cancelled and not row.is_emptied
    before = [CUT_SHORT] if is_superseded and whats[-2:-1] == [CUT_SHORT] else []
    expect(whats[: len(whats) - 1 - len(before)] == [SETTLED] * (len(whats) - 1 - len(before)), row, "after:", whats)
    last = whats[-1] if whats else SETTLED
    expected = CANCELLED if row.is_cancelled else EMPTIED if row.is_emptied else SUPERSEDED if is_superseded else None
    expect(expected in (None, last), row, "was retired without a revision")
    expect((last in (CANCELLED, EMPTIED, SUPERSEDED)) == (expected is not None), row, "revised, and not retired")
    if last == CUT_SHORT:
        expect(revisions[-1][0] == row.ended_tx and revisions[-1][3] > row.end_time, row, "was not cut short")


def _existence_ends(rows, types):
    """The ends of an object's existences, with adjacent existences of the same type joined (rule C6)."""
    ends = []
    for index, row in enumerate(rows):
        if row.is_negative or row.end_time == OPEN:
            continue
        after = rows[index + 1] if index + 1 < len(rows) else None
        joined = after is not None and after.initial_time == row.end_time and not after.is_negative
        if not (joined and types[after.key].lower() == types[row.key].lower()):
            ends.append(row.end_time)
    return ends
