"""kbstore in a schema of its own, beside a service whose tables may have the same names."""

import pytest
import sqlalchemy as sa
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext

import kbstore
from kbstore import sql
from tests.service.conftest import DOMAIN

TABLES = sorted(name for name in sql.__all__ if isinstance(getattr(sql, name), sa.Table))


@pytest.fixture
def service(empty_database):
    """The engine of a service on PostgreSQL."""
    engine = sa.create_engine(empty_database)
    yield engine
    engine.dispose()


def with_transactions(service, schema=None):
    """The service's own table `transactions`, made in the database."""
    own = sa.MetaData(schema=schema)
    sa.Table("transactions", own, sa.Column("id", sa.Integer, primary_key=True), sa.Column("parcel", sa.Text))
    with service.begin() as connection:
        if schema is not None:
            connection.execute(sa.schema.CreateSchema(schema))
        own.create_all(connection)
    return own


def proposals(service, own, include_name, *, include_schemas):
    """What Alembic's autogenerate would change."""
    options = {"include_name": include_name, "include_schemas": include_schemas}
    with service.connect() as connection:
        return compare_metadata(MigrationContext.configure(connection, opts=options), own)


@pytest.mark.parametrize("include_schemas", [False, True])
def test_a_table_of_the_services_with_a_name_of_kbstores(service, include_schemas):
    """Names of kbstore are left out in its schema only: the service's own `transactions` is compared."""
    own = with_transactions(service)
    knowledge = sql.in_schema("knowledge")
    with kbstore.open(service, "post", schema="knowledge") as kb:
        kb.load(DOMAIN)
    assert proposals(service, own, knowledge.include_name, include_schemas=include_schemas) == []
    own.remove(own.tables["transactions"])
    ((change, table),) = proposals(service, own, knowledge.include_name, include_schemas=include_schemas)
    assert (change, table.fullname) == ("remove_table", "transactions")


def test_a_table_of_another_schema_with_a_name_of_kbstores(service):
    """With kbstore in the default schema, `sql.include_name` leaves out its names there and nowhere else."""
    own = with_transactions(service, "billing")
    with kbstore.open(service, "post") as kb:
        kb.load(DOMAIN)
    assert proposals(service, own, sql.include_name, include_schemas=True) == []
    own.remove(own.tables["billing.transactions"])
    ((change, table),) = proposals(service, own, sql.include_name, include_schemas=True)
    assert (change, table.fullname) == ("remove_table", "billing.transactions")
