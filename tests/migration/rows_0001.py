"""A small store written by hand in SQL, as revision 0001 stores it, so that an upgrade has data to lose."""

import hashlib

import sqlalchemy as sa

OPEN = 2**63 - 1

ROWS = {
    "knowledge_bases": [
        {
            "id": 1,
            "name": "kenny",
            "use_unknowns": False,
        }
    ],
    "heads": [
        {
            "kb_id": 1,
            "domain_version": 0,
            "present": 7,
            "last_number": 3,
            "last_time": 30,
            "last_token": 333,
            "last_late": 0,
            "last_timeline": 4,
            "last_run": 0,
            "history_from": 0,
        }
    ],
    "transactions": [
        {
            "kb_id": 1,
            "number": 1,
            "recorded_time": 10,
            "changes": 2,
            "token": 111,
            "last_timeline": 3,
            "client": "mapper",
        },
        {"kb_id": 1, "number": 2, "recorded_time": 20, "changes": 1, "token": 222, "last_timeline": 4},
        {"kb_id": 1, "number": 3, "recorded_time": 30, "changes": 1, "token": 333, "last_timeline": 4, "note": "late"},
    ],
    "timelines": [
        {"id": 1, "kb_id": 1, "role": 0, "knowledge_type": 0, "key": "wp0", "spelling": "WP0"},
        {"id": 2, "kb_id": 1, "role": 0, "knowledge_type": 1, "key": "visited wp0", "spelling": "visited WP0"},
        {"id": 3, "kb_id": 1, "role": 0, "knowledge_type": 2, "key": "battery", "spelling": None},
        {"id": 4, "kb_id": 1, "role": 1, "knowledge_type": 1, "key": "visited wp0", "spelling": None},
    ],
    "mentions": [{"kb_id": 1, "object_id": 1, "timeline_id": 2}],
    "instances": [
        {"recorded_tx": 1, "seq": 0, "timeline_id": 1, "initial_time": 10, "end_time": OPEN, "instance_type": "room"}
    ],
    "facts": [
        # recorded at 10, replaced by its negation at 20, which transaction 3 removed at 30
        {"recorded_tx": 1, "seq": 1, "timeline_id": 2, "initial_time": 10, "end_time": 20, "level": 4, "ended_tx": 2},
        {"recorded_tx": 2, "seq": 0, "timeline_id": 2, "initial_time": 20, "end_time": 30, "level": 3, "ended_tx": 3},
        {"recorded_tx": 2, "seq": 1, "timeline_id": 4, "initial_time": 20, "end_time": OPEN},
    ],
    "functions": [
        {
            "recorded_tx": 2,
            "seq": 2,
            "timeline_id": 3,
            "initial_time": 20,
            "end_time": OPEN,
            "function_value": 80.0,
            "own_rate": -2e8,
            "rate": -2e8,
        }
    ],
}
"""Rows of revision 0001; columns that all assertions have are filled in."""


def fill(engine):
    """Write the rows, and return their digest."""
    with engine.begin() as connection:
        for table, rows in ROWS.items():
            for row in rows:
                columns = dict(row)
                if "initial_time" in columns:
                    is_negative = table == "facts" and row["initial_time"] == 20
                    columns = {"kb_id": 1, "is_negative": is_negative, "level": 62} | columns
                names = ", ".join(columns)
                values = ", ".join(f":{name}" for name in columns)
                connection.execute(sa.text(f"INSERT INTO {table} ({names}) VALUES ({values})"), columns)
    return digest(engine)


def digest(engine):
    """A digest of all rows of the tables that `fill` wrote to."""
    seen = hashlib.sha256()
    with engine.connect() as connection:
        for table in ROWS:
            for row in connection.execute(sa.text(f"SELECT * FROM {table} ORDER BY 1, 2, 3")):
                seen.update(repr(tuple(row)).encode())
    return seen.hexdigest()


def objects(engine):
    """The names of all tables, indexes and views."""
    if engine.dialect.name == "sqlite":
        question = "SELECT name FROM sqlite_master"
    else:
        question = "SELECT relname FROM pg_class WHERE relnamespace = to_regnamespace(current_schema())"
    with engine.connect() as connection:
        return set(connection.execute(sa.text(question)).scalars())
