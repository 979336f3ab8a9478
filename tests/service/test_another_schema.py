"""kbstore in a schema of its own, beside a service whose tables may have the same names."""

import pytest
import sqlalchemy as sa
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext

import kbstore
from kbstore import sql
from kbstore.clock import seconds
from tests.service.conftest import DOMAIN

NOW = seconds(1000)
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


# -- reading ------------------------------------------------------------------------------------------------------


@pytest.fixture
def kb(service):
    """A knowledge base in the schema `knowledge`, beside a table of the service's in the default one."""
    with service.begin() as connection:
        connection.execute(sa.text("CREATE TABLE parcels (name text, weight float)"))
        connection.execute(sa.text("INSERT INTO parcels VALUES ('p1', 2.5), ('p2', 7)"))
    with kbstore.open(service, "post", schema="knowledge", clock=kbstore.ManualClock(NOW)) as kb:
        kb.load(DOMAIN)
        kb.add("p1 - parcel", "p2 - parcel", "hall - place", "attic - place")
        kb.add("(parcel_at p1 hall)", "(parcel_at p2 attic)")
        yield kb


def test_a_table_of_the_service_is_joined_with_facts_of_the_schema(kb, service):
    """One statement reads the service's table in the default schema and kbstore's views and tables in theirs."""
    knowledge = sql.in_schema("knowledge")
    parcels = sa.table("parcels", sa.column("name"), sa.column("weight"))
    held = knowledge.current_facts
    from_view = (
        sa.select(parcels.c.name, parcels.c.weight, knowledge.argument(held, 2))
        .join(held, knowledge.argument(held, 1) == parcels.c.name)
        .order_by(parcels.c.name)
    )
    timelines, facts = knowledge.timelines, knowledge.facts
    from_tables = (
        sa.select(parcels.c.name, knowledge.as_datetime(facts.c.initial_time))
        .join(timelines, knowledge.argument(timelines, 1) == parcels.c.name)
        .join(facts, (facts.c.kb_id == timelines.c.kb_id) & (facts.c.timeline_id == timelines.c.id))
        .where(facts.c.end_time.is_(None))
        .order_by(parcels.c.name)
    )
    with service.connect() as connection:
        assert connection.execute(from_view).all() == [("p1", 2.5, "hall"), ("p2", 7.0, "attic")]
        rows = connection.execute(from_tables).all()
    assert [(name, since.timestamp()) for name, since in rows] == [("p1", 1000), ("p2", 1000)]


def test_every_table_and_view_can_be_read_in_a_schema(kb, service):
    """`in_schema` has each table and view of `sql` under its name, with the same columns, in that schema."""
    knowledge = sql.in_schema("knowledge")
    assert {table.name for table in knowledge.metadata.tables.values()} == set(sql.metadata.tables)
    with service.connect() as connection:
        for name in TABLES:
            table = getattr(knowledge, name)
            assert table.fullname == f"knowledge.{name}"
            assert table.columns.keys() == getattr(sql, name).columns.keys()
            connection.execute(sa.select(table)).all()


def test_a_schema_is_the_same_tables_each_time():
    """Aliases and cached statements of the same tables; without a schema, those of the module itself."""
    assert sql.in_schema("knowledge").facts is sql.in_schema("knowledge").facts
    assert sql.in_schema(None).facts is sql.facts
