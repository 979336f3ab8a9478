"""Restores rows as they were after a transaction: the changes by later ones are undone by means of revisions."""

from kbstore.clock import OPEN
from kbstore.storage.connection import StoreConnection
from kbstore.storage.tables import RevisionKind
from kbstore.transfer.queries import assertions, revisions_after
from kbstore.transfer.rows import Record


class PastRows:
    """Rows as they were after the transaction `upto`, at a time before the next one."""

    def __init__(self, connection: StoreConnection, kb: int, upto: int, time: int) -> None:
        self._upto = upto
        self._time = time
        self._revisions: dict[tuple[int, int], tuple[int, int]] = {}
        self._cancelled: set[tuple[int, int]] = set()
        for number, seq, tx, what, end_before in connection.all(revisions_after, {"kb": kb, "upto": upto}):
            # the first change after `upto` has the end before it
            self._revisions.setdefault((number, seq), (tx, end_before))
            if what == RevisionKind.CANCELLED:
                self._cancelled.add((number, seq))

    def of(self, table: str, record: Record) -> Record:
        """Return a row of a table as it was."""
        if table in assertions:
            return self._assertion(table, record)
        if table == "schedules" and (record["recorded_tx"], record["seq"]) in self._cancelled:
            return record | {"until_time": record["initial_time"]}
        if table == "runs" and self._is_later(record["ended_tx"]):
            return record | {"end_time": OPEN, "ended_tx": None, "outcome": None}
        return record

    def _assertion(self, table: str, record: Record) -> Record:
        ended = record["ended_tx"]
        revision = self._revisions.get((record["recorded_tx"], record["seq"]))
        if revision is not None and (not self._is_later(ended) or revision[0] <= ended):
            record = record | {"end_time": revision[1]}
        elif self._is_later(ended):
            # a row that ended without a revision had been open
            record = record | {"end_time": OPEN}
        if self._is_later(ended):
            record = record | {"ended_tx": None, "end_cause": None}
        if self._is_later(record["retired_tx"]):
            record = record | {"retired_tx": None}
        if table == "functions" and record["initial_time"] > self._time and record["retired_tx"] is None:
            # future rates are derived again: by the target of a push, or by a question to an archive about the future
            record = record | {"rate": record["own_rate"]}
        return record

    def _is_later(self, number: int | None) -> bool:
        return number is not None and number > self._upto
