"""Deltas: reads what some transactions of a knowledge base did, as rows, and writes them into a copy.

The rows are read on one snapshot: those that the transactions recorded, and older ones that they changed. If the store
has gone on since, each row is copied as it was after the last of these transactions.
"""

import json
from collections import defaultdict
from collections.abc import Iterator, Sequence
from itertools import islice
from operator import itemgetter
from typing import NamedTuple

from kbstore.messages import KnowledgeType
from kbstore.storage import tables
from kbstore.storage.assertion_queries import for_kind
from kbstore.storage.connection import StoreConnection
from kbstore.storage.interval_tree import LEVELS, superseded
from kbstore.storage.records import Head
from kbstore.transfer import delta_queries as statements
from kbstore.transfer.past import PastRows
from kbstore.transfer.queries import assertions, by_table
from kbstore.transfer.rows import BATCH, LogRange, Record, RowSource, RowTarget, batches

Keys = dict[str, list[tuple[int, int]]]
"""The keys of rows, in order, by table."""

_NUMBERS = ("recorded_tx", "ended_tx", "retired_tx", "told_tx")


class Span(NamedTuple):
    """The transactions after the end of a copy's log, `before`, and up to the number `upto`, with its time."""

    before: Head
    upto: int
    time: int


class Delta:
    """The work of the transactions of a span, on a snapshot of their store.

    Attributes:
        source: reads the rows.
        is_latest: whether the span ends with the last transaction of the store.
    """

    def __init__(self, connection: StoreConnection, name: str, span: Span) -> None:
        self.source = RowSource(connection, name, LogRange(after=span.before.number, upto=span.upto))
        self.is_latest = span.upto == self.source.head.number
        self._connection = connection
        self._span = span
        self._past = None if self.is_latest else PastRows(connection, self.source.kb, span.upto, span.time)
        self._referred: set[int] = set()
        self._rows = 0

    def write(self, connection: StoreConnection, target: RowTarget, source: str) -> Head:
        """Write the rows into a copy whose log ends where the span begins, under its lock, and return its new head.

        `source` is the name by which the copy knows its original.
        """
        before = self._span.before
        open_runs = [row[0] for row in connection.all(statements.open_runs, {"kb": target.kb})]
        with connection.together():
            for statement in statements.delete_derived:
                connection.run(statement, {"kb": target.kb, "t": before.time})
            head = self._write_tables(target, self._head(source), open_runs)
            target.put_head(head)
        return head

    @property
    def rows(self) -> int:
        """The number of rows that have been written."""
        return self._rows

    def _head(self, source: str) -> Head:
        """Return the head of the copy, except for the parts that follow from the rows."""
        before, latest = self._span.before, self.source.head
        history_from = before.history_from if before.number else latest.history_from
        if self.is_latest:
            return latest._replace(history_from=history_from, source=source)
        return before._replace(
            number=self._span.upto,
            time=self._span.time,
            token=self.source.token,
            timeline=self.source.timeline,
            history_from=history_from,
            present=latest.present,
            source=source,
        )

    def _write_tables(self, target: RowTarget, head: Head, open_runs: Sequence[int]) -> Head:
        keys = self._older()
        metrics: set[int] = set()
        for table in by_table:
            for records in batches(self._records(table, keys, open_runs)):
                target.add(table, records)
                self._rows += len(records)
                match table:
                    case "transactions":
                        late = [record["number"] for record in records if record["late_from"] is not None]
                        head = head._replace(late=max(head.late, *late, 0))
                    case "domains":
                        head = head._replace(domain_version=records[-1]["version"])
                    case "runs":
                        head = head._replace(last_run=max(head.last_run, records[-1]["number"]))
                    case "expressions":
                        metrics.update(record["timeline_id"] for record in records)
        if metrics:
            known = self._connection.array(sorted(metrics))
            target.add("mentions", list(self.source.records("mentions", statements.other_mentions, ids=known)))
        if self._span.before.history_from and self._referred:
            # transactions that the copy has archived, and needs again
            numbers = self._connection.array(sorted(self._referred))
            found = self.source.records("transactions", statements.transactions_numbered, numbers=numbers)
            target.add("transactions", list(found))
        return head

    # -- reading ----------------------------------------------------------------------------------------------

    def _records(self, table: str, keys: Keys, open_runs: Sequence[int]) -> Iterator[Record]:
        """Yield the rows of a table as they were after the last transaction of the span, older ones first."""
        for stored in self._stored(table, keys, open_runs):
            record = stored if self._past is None else self._past.of(table, stored)
            if table in assertions:
                self._referred.update(record[name] for name in _NUMBERS if record[name] is not None)
            yield record

    def _stored(self, table: str, keys: Keys, open_runs: Sequence[int]) -> Iterator[Record]:
        older = iter(keys.get(table, ()))
        while some := list(islice(older, BATCH)):
            found = self.source.records(table, statements.keyed[table], pairs=json.dumps(some))
            # a row that has been replaced comes before the one that takes its place
            yield from sorted(found, key=itemgetter("recorded_tx", "seq"))
        if table == "runs" and open_runs:
            numbers = self._connection.array(open_runs)
            yield from self.source.records(table, statements.known_runs, open_runs=numbers)
        before = self._span.before
        if table == "mentions" and self.source.timeline == before.timeline:
            # without a new timeline there is none, and looking for them, object by object, takes time
            return
        yield from self.source.records(
            table,
            statements.new_mentions if table == "mentions" else statements.recorded[table],
            known_timelines=before.timeline,
            known_version=before.domain_version,
            known_run=before.last_run,
        )

    def _older(self) -> Keys:
        """Return the keys of the rows that the copy has, and that the transactions changed."""
        before = self._span.before
        if not before.number:
            return {}
        chosen = {"kb": self.source.kb, "after": before.number, "upto": self._span.upto}
        found: dict[str, set[tuple[int, int]]] = defaultdict(set)
        for kind, *key in self._connection.all(statements.revised, chosen):
            for table in (tables.assertion_tables[KnowledgeType(kind)].name, "schedules"):
                found[table].add((key[0], key[1]))
        for number, seq in self._connection.all(statements.ahead, chosen | {"t": before.time}):
            for table in ("functions", "schedules"):
                found[table].add((number, seq))
        closed = range(LEVELS)
        levels = self._connection.array([*closed, *map(superseded, closed)])
        ending = chosen | {"first": before.time, "last": self._span.time, "levels": levels}
        for queries in for_kind.values():
            for row in self._connection.all(queries.ended, ending):
                if row[3] <= before.number:
                    found[queries.table].add((row[3], row[4]))
        return {table: sorted(some) for table, some in found.items()}
