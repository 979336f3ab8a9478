"""A host's rules for SQLAlchemy's generic types do not affect kbstore's tables and statements.

SQLAlchemy-Continuum, as soon as it is imported, makes each BigInteger an INTEGER on SQLite.
"""

from kbstore.storage import schema, schema_objects
from tests.migration.processes import compile_under_rules, live_under_rules
from tests.processes import finish, start


def test_a_store_has_its_schema_under_any_rules_of_the_host(engine):
    """It is set up, opened again, and migrated down and up, with the same columns as elsewhere."""
    finish(start(live_under_rules, engine.url.render_as_string(hide_password=False)))
    schema.check(engine.url)
    if engine.dialect.name == "sqlite":
        with engine.connect() as connection:
            assert schema_objects.is_as_migrated(connection)


def test_statements_are_the_same_under_any_rules_of_the_host():
    """No cast, not even of a parameter, is to a type of the host's choice."""
    finish(start(compile_under_rules))
