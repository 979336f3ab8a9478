"""The tables and views of a store as `Table` objects, in one schema of the database."""

from collections.abc import Mapping, MutableMapping
from typing import Any, Literal

from sqlalchemy import BigInteger, Boolean, Column, Double, Integer, MetaData, String, Table, Text
from sqlalchemy.types import TypeEngine

from kbstore.sql.arguments import argument
from kbstore.sql.types import End, Nanoseconds, as_datetime
from kbstore.storage.schema_objects import VERSION_TABLE
from kbstore.storage.tables import metadata as stored

_TIMES = {"initial_time", "recorded_time", "until_time", "last_time", "history_from", "late_from"}
_ENDS = {"end_time", "end_before"}

_Types = Mapping[str, TypeEngine[Any]]

_KNOWLEDGE_BASE: _Types = {"knowledge_base": Text()}
_ATOM: _Types = {"name": Text(), "arguments": Text()}
_SIGNED: _Types = {"is_negative": Boolean()}
_NUMBER: _Types = {"value": Double(), "rate": Double()}
_SPAN: _Types = {"initial_time": String(30), "end_time": String(30)}
_IN_NANOSECONDS: _Types = {"initial_ns": Nanoseconds(), "end_ns": Nanoseconds()}
_TIMELINE: _Types = {"timeline_key": Text(), "timeline_id": BigInteger()}
_PAST: _Types = {
    **_SPAN,
    "ended_by": Text(),
    "recorded_tx": BigInteger(),
    "recorded_time": String(30),
    "recorded_client": Text(),
    "ended_tx": BigInteger(),
    "ended_client": Text(),
    "cancelled_tx": BigInteger(),
    "cancelled_time": String(30),
    "cancelled_client": Text(),
    "superseded_tx": BigInteger(),
    "known_from": String(30),
    "known_until": String(30),
    **_IN_NANOSECONDS,
    **_TIMELINE,
}
_PRESENT: _Types = {
    **_SPAN,
    "recorded_tx": BigInteger(),
    "recorded_client": Text(),
    **_IN_NANOSECONDS,
    "as_of_ns": Nanoseconds(),
    **_TIMELINE,
}


class SchemaTables:
    """The names of `kbstore.sql` for a store in one schema of a PostgreSQL database: its tables and views.

    Attributes:
        schema: the schema; None for the default one of a connection.
        metadata: the tables, without the views. kbstore's migrations create them, when a store is opened; do not use
            ``create_all``.
    """

    argument = staticmethod(argument)
    as_datetime = staticmethod(as_datetime)

    def __init__(self, schema: str | None) -> None:
        self.schema = schema
        self.metadata = MetaData(schema=schema, naming_convention=stored.naming_convention)
        self.knowledge_bases = self._table("knowledge_bases")
        self.heads = self._table("heads")
        self.transactions = self._table("transactions")
        self.domains = self._table("domains")
        self.symbols = self._table("symbols")
        self.timelines = self._table("timelines")
        self.mentions = self._table("mentions")
        self.instances = self._table("instances")
        self.facts = self._table("facts")
        self.functions = self._table("functions")
        self.expressions = self._table("expressions")
        self.inequalities = self._table("inequalities")
        self.schedules = self._table("schedules")
        self.revisions = self._table("revisions")
        self.runs = self._table("runs")
        # not in `metadata`, whose `create_all` would make tables of them
        self._views = MetaData(schema=schema)
        self.fact_history = self._view("fact_history", {"fact": Text()}, _ATOM, _SIGNED, _PAST)
        self.function_history = self._view("function_history", {"function": Text()}, _ATOM, _NUMBER, _PAST)
        self.instance_history = self._view("instance_history", {"name": Text(), "type": Text()}, _SIGNED, _PAST)
        self.goal_history = self._view("goal_history", {"goal": Text()}, _PAST)
        self.current_facts = self._view("current_facts", {"fact": Text()}, _ATOM, _SIGNED, _PRESENT)
        self.current_functions = self._view("current_functions", {"function": Text()}, _ATOM, _NUMBER, _PRESENT)
        self.current_instances = self._view("current_instances", {"name": Text(), "type": Text()}, _PRESENT)
        self.current_goals = self._view("current_goals", {"goal": Text()}, _PRESENT)
        self.run_history = self._view(
            "run_history",
            {
                "action": Text(),
                "operator": Text(),
                "arguments": Text(),
                "started": String(30),
                "expected_end": String(30),
                "ended": String(30),
                "outcome": Text(),
                "duration_s": Double(),
                "forced": Text(),
                "started_tx": BigInteger(),
                "started_client": Text(),
                "ended_tx": BigInteger(),
                "ended_client": Text(),
                "started_ns": Nanoseconds(),
                "expected_end_ns": Nanoseconds(),
                "ended_ns": Nanoseconds(),
            },
        )
        self.transaction_log = self._view(
            "transaction_log",
            {
                "number": BigInteger(),
                "recorded_time": String(30),
                "client": Text(),
                "note": Text(),
                "changes": Integer(),
                "recorded_ns": Nanoseconds(),
            },
        )

    def _table(self, name: str) -> Table:
        table = stored.tables[name].to_metadata(self.metadata, schema=self.schema)  # type: ignore[arg-type]
        for column in table.columns:
            if column.name in _ENDS:
                column.type = End()
            elif column.name in _TIMES:
                column.type = Nanoseconds()
        return table

    def _view(self, name: str, *parts: _Types) -> Table:
        columns = {column: type_ for part in (_KNOWLEDGE_BASE, *parts) for column, type_ in part.items()}
        return Table(name, self._views, *(Column(column, type_) for column, type_ in columns.items()))

    def include_name(
        self,
        name: str | None,
        type_: Literal["schema", "table", "column", "index", "unique_constraint", "foreign_key_constraint"],
        parent_names: MutableMapping[Any, str | None],
    ) -> bool:
        """Tell Alembic's autogenerate to leave kbstore's tables alone, which are in this schema.

        For ``context.configure(include_name=...)``. A table of the same name in another schema is compared. Alembic
        names the default schema of its connection None: for a store in that one it is `kbstore.sql.include_name`.
        """
        if type_ != "table" or parent_names.get("schema_name") != self.schema:
            return True
        return not (name in stored.tables or name == VERSION_TABLE)
