"""The functions that migrating processes run."""

import os
import signal

import sqlalchemy as sa
from sqlalchemy.ext.compiler import compiles

import kbstore
from kbstore.storage import queries, schema
from kbstore.storage.assertion_queries import for_kind
from kbstore.storage.statements import Statement
from kbstore.storage.whole_state import whole_state
from tests.migration import stored_mission


def upgrade(url, barrier=None):
    """Upgrade; with a barrier, when all are ready."""
    if barrier is not None:
        barrier.wait()
    schema.upgrade(url, backup=False)


def upgrade_killed_at(url, statement):
    """Upgrade, and be killed (as by kill -9) right before the given statement, counted from 1, is sent."""
    sent = 0

    def count(*_):
        nonlocal sent
        sent += 1
        if sent == statement:
            os.kill(os.getpid(), signal.SIGKILL)

    sa.event.listen(sa.Engine, "before_cursor_execute", count)
    schema.upgrade(url, backup=False)


RULES = {
    "BigInteger": "INTEGER",
    "Boolean": "BOOL",
    "Double": "REAL",
    "Float": "REAL",
    "Integer": "BIGINT",
    "Numeric": "REAL",
    "SmallInteger": "INTEGER",
    "String": "TEXT",
    "Text": "VARCHAR",
}
"""SQLAlchemy's generic types, each with a type that a host may prefer."""


def live_under_rules(url):
    """Set a store up, write and read it, and migrate it, in a program with its own rules for generic types."""
    for name, other in RULES.items():
        compiles(getattr(sa, name))(lambda *_, other=other, **__: other)
    assert str(sa.BigInteger().compile()) == "INTEGER"
    stored_mission.play(url)
    with kbstore.open(url, stored_mission.NAME) as kb:
        stored_mission.check_answers(kb)
    schema.check(url)
    schema.downgrade(url, "0001", backup=False)
    schema.upgrade(url, backup=False)
    with kbstore.open(url, stored_mission.NAME, read_only=True) as kb:
        stored_mission.check_answers(kb)


def compile_under_rules():
    """Compile all statements for both engines, in a program that has a rule for each generic type."""
    for name in RULES:
        compiles(getattr(sa, name))(lambda *_, **__: "somethingelse")
    own = [getattr(kind, name) for kind in for_kind.values() for name in vars(type(kind))]
    found = [each for each in (*vars(queries).values(), *own) if isinstance(each, Statement)]
    assert len(found) > 150
    for statement in (*found, whole_state(tuple(for_kind))):
        for dialect in ("sqlite", "postgresql"):
            assert "somethingelse" not in str(statement._compiled(dialect))
