"""What is always so in the tables of a store, whatever has been done: read by plain SQL, reckoned anew."""

from itertools import pairwise

from kbstore.clock import OPEN

TABLES = {"instances": 1, "facts": 2, "functions": 3, "expressions": 4, "inequalities": 5}
COLUMNS = (
    "id, timeline_id, initial_time, end_time, recorded_tx, recorded_time, ended_tx, end_cause,"
    " cancelled_tx, cancelled_time, level, pending_node, is_negative"
)


def node(start, end):
    """Where the interval tree keeps an interval: the shared leading bits of its two ends, a one, and zeros."""
    if end in (OPEN, start):
        return None
    first, last = format(start + 1, "063b"), format(end, "063b")
    parting = next((place for place in range(63) if first[place] != last[place]), 63)
    return end if parting == 63 else int(first[:parting] + "1" + "0" * (62 - parting), 2)


def level(start, end):
    """How many zeros its node ends with: all that a row keeps of it."""
    where = node(start, end)
    return None if where is None else len(format(where, "b")) - len(format(where, "b").rstrip("0"))


class Row:
    """A row of one of the five tables."""

    def __init__(self, table, values):
        self.table = table
        for name, value in zip(COLUMNS.replace(" ", "").split(","), values, strict=True):
            setattr(self, name, value)
        self.type_name = None

    def __repr__(self):
        return f"{self.table} {self.id} [{self.initial_time}, {self.end_time})"


def violations(execute, kb):
    """What is wrong in the tables of one knowledge base; `execute` runs SQL and gives the rows."""
    found = []

    def expect(condition, *what):
        if not condition:
            found.append(" ".join(map(str, what)))

    number, latest = execute(f"SELECT last_number, last_time FROM knowledge_bases WHERE id = {kb}")[0]
    times = dict(execute(f"SELECT number, recorded_time FROM transactions WHERE kb_id = {kb}"))
    expect(sorted(times) == list(range(1, number + 1)), "numbers have gaps:", sorted(times), "last", number)
    expect(all(times[a] <= times[b] for a, b in pairwise(sorted(times))), "time runs backwards")
    expect(times.get(number, 0) == latest, "the head is not at the last transaction's time")

    timelines = {
        row[0]: row[1:] for row in execute(f"SELECT id, role, knowledge_type, key FROM timelines WHERE kb_id = {kb}")
    }
    mentions = set(execute(f"SELECT object_id, timeline_id FROM mentions WHERE kb_id = {kb}"))
    objects = {key: id for id, (role, kind, key) in timelines.items() if (role, kind) == (0, 0)}
    standing, empty = {}, {}
    for table in TABLES:
        for values in execute(f"SELECT {COLUMNS} FROM {table} WHERE kb_id = {kb}"):
            row = Row(table, values)
            _check_row(row, times, expect)
            if row.end_time > row.initial_time:
                standing.setdefault((table, row.timeline_id), []).append(row)
            elif row.cancelled_tx is None:
                empty.setdefault((table, row.timeline_id), []).append(row.initial_time)
    types = dict(execute(f"SELECT id, instance_type FROM instances WHERE kb_id = {kb}"))
    existence_ends = {}
    for (table, timeline), rows in standing.items():
        rows.sort(key=lambda row: row.initial_time)
        for before, after in pairwise(rows):
            expect(before.end_time <= after.initial_time, before, "overlaps", after)
        if table == "instances":
            existence_ends[timelines[timeline][2]] = _existence_ends(rows, types)
    for (table, timeline), rows in standing.items():
        if table not in ("facts", "functions"):
            continue
        arguments = timelines[timeline][2].split(" ")[1:]
        for name in arguments:
            expect((objects.get(name), timeline) in mentions, timelines[timeline], "is not known to mention", name)
        for index, row in enumerate(rows):
            if row.ended_tx is None:
                ahead = [end for name in arguments for end in existence_ends.get(name, ()) if end > row.initial_time]
                ahead += [after.initial_time for after in rows[index + 1 : index + 2]]
                # what began and ended at one time has ended what was before it, too
                ahead += [t for t in empty.get((table, timeline), ()) if t > row.initial_time]
                expect(row.end_time == min(ahead, default=OPEN), row, "should end at", min(ahead, default=OPEN))
    for row in execute(
        f"SELECT number, initial_time, end_time, node, ended_tx, recorded_tx FROM runs WHERE kb_id = {kb}"
    ):
        _, start, end, kept, ended, recorded = row
        expect(kept == node(start, end), "run", row, "is kept at the wrong node")
        expect(start == times[recorded], "run", row, "starts when it is not recorded")
        expect(end == OPEN if ended is None else end == times[ended], "run", row, "ends at a wrong time")
    return found


def _check_row(row, times, expect):
    """What concerns a row alone, and the transactions that touched it."""
    recorded = times[row.recorded_tx]
    expect(row.initial_time <= row.end_time, row, "ends before it begins")
    expect(row.level == level(row.initial_time, row.end_time), row, "is kept on the wrong level", row.level)
    if row.recorded_time is None:
        expect(row.initial_time == recorded, row, "is not of its transaction's time", recorded)
        expect(row.pending_node is None, row, "was never pending")
        expect(row.cancelled_tx is None, row, "took effect and was cancelled")
    else:
        until = row.initial_time if row.cancelled_time is None else row.cancelled_time
        expect(row.recorded_time == recorded < row.initial_time, row, "was not scheduled ahead")
        expect(row.pending_node == node(row.recorded_time, until), row, "was pending at the wrong node")
    expect((row.cancelled_tx is None) == (row.cancelled_time is None), row, "is half cancelled")
    if row.cancelled_tx is not None:
        expect(row.end_time == row.initial_time, row, "was cancelled and stands")
        expect(row.cancelled_time == times[row.cancelled_tx] < row.initial_time, row, "was cancelled too late")
        expect(row.ended_tx is None, row, "was cancelled and ended")
    expect((row.ended_tx is None) == (row.end_cause is None), row, "ended without a cause")
    if row.ended_tx is not None:
        expect(row.end_time == times[row.ended_tx], row, "did not end with its transaction")
        expect(row.end_cause in (1, 2, 3, 4, 5), row, "ended for no known cause")


def _existence_ends(rows, types):
    """When an object ceases to exist, adjacent existences of the same type being one (rule C6)."""
    ends = []
    for index, row in enumerate(rows):
        if row.is_negative or row.end_time == OPEN:
            continue
        after = rows[index + 1] if index + 1 < len(rows) else None
        joined = after is not None and after.initial_time == row.end_time and not after.is_negative
        if not (joined and types[after.id].lower() == types[row.id].lower()):
            ends.append(row.end_time)
    return ends
