"""kbstore beside a service's own tables, models and migrations."""

from datetime import UTC, datetime

import pytest
import sqlalchemy as sa
from alembic import command
from alembic.util import CommandError
from sqlalchemy.orm import Session

import kbstore
from kbstore import sql
from kbstore.clock import ManualClock, seconds
from tests.service.conftest import DOMAIN, alembic
from tests.service.models import Order, Parcel


def views(engine):
    return sorted(sa.inspect(engine).get_view_names())


def test_autogenerate_proposes_nothing_of_kbstore(kb, service):
    """The service's own `alembic check` finds no difference in a database with kbstore's tables and views."""
    alembic(service, command.check)


def test_autogenerate_still_sees_the_services_own_tables(kb, service):
    """`include_name` leaves out kbstore's tables only: a table that the models lack is found."""
    with service.begin() as connection:
        connection.execute(sa.text("CREATE TABLE forgotten (id INTEGER PRIMARY KEY)"))
    with pytest.raises(CommandError, match="forgotten"):
        alembic(service, command.check)


def test_the_services_migrations_run_after_kbstore_has_made_its_tables(engine):
    """In the other order: kbstore's tables first, then those of the service, and the store still opens."""
    with kbstore.open(engine, "post") as kb:
        kb.load(DOMAIN)
    alembic(engine, lambda config: command.upgrade(config, "head"))
    with kbstore.open(engine, "post") as kb:
        assert kb.domain.name == "post"


def test_each_view_has_a_table_with_its_columns(kb, service):
    """`kbstore.sql` names each view of the store, with its columns in their order."""
    inspector = sa.inspect(service)
    for name in views(service):
        assert [column.name for column in getattr(sql, name).columns] == [
            column["name"] for column in inspector.get_columns(name)
        ]
    declared = {name for name in sql.__all__ if isinstance(getattr(sql, name), sa.Table)}
    assert declared == {*views(service), *sql.metadata.tables}


def test_a_value_of_each_column_of_each_view_and_table_can_be_read(kb, service):
    """What the database has is read as the type that is declared: a number, a text, a bool, or None."""
    with service.connect() as connection:
        for name in sql.__all__:
            if isinstance(getattr(sql, name), sa.Table):
                for row in connection.execute(sa.select(getattr(sql, name))):
                    for column, value in zip(getattr(sql, name).columns, row, strict=True):
                        type_ = getattr(column.type, "impl_instance", column.type).python_type
                        assert value is None or type(value) is type_, f"{name}.{column.name}"


def test_one_value_of_each_kind(kb, service):
    """A text, a bool, a decimal and a whole number, a time as text and in nanoseconds, and an end that is open."""
    number = kb.add("(not (parcel_at p1 attic))", client="scales").number
    told, numbers = sql.fact_history.c, sql.current_functions.c
    with service.connect() as connection:
        fact = sa.select(
            told.knowledge_base,
            told.fact,
            told.is_negative,
            told.initial_time,
            told.end_time,
            told.initial_ns,
            told.end_ns,
            told.recorded_tx,
            told.recorded_client,
            told.ended_by,
        ).where(told.recorded_tx == number)
        moment = "1970-01-01T00:16:40.000000000Z"
        assert connection.execute(fact).all() == [
            ("post", "(not (parcel_at p1 attic))", True, moment, None, seconds(1000), None, number, "scales", None)
        ]
        assert connection.execute(sa.select(numbers.function, numbers.value, numbers.rate)).all() == [
            ("(battery kenny)", 80.0, 0.0)
        ]
        stored = sa.select(sql.facts.c.is_negative, sql.facts.c.initial_time, sql.facts.c.end_time)
        assert connection.execute(stored.where(sql.facts.c.recorded_tx == number)).all() == [
            (True, seconds(1000), None)
        ]


def test_a_table_of_the_service_is_joined_with_facts(kb, service):
    """An argument of a fact is joined with a column of the service's own: from a view, and from the tables."""
    with Session(service) as session, session.begin():
        session.add_all([Parcel(name="p1", weight=2.5), Parcel(name="p2", weight=7.0)])
    held = sql.current_facts
    from_view = (
        sa.select(Parcel.name, Parcel.weight, sql.argument(held, 2))
        .join(held, sql.argument(held, 1) == Parcel.name)
        .where(held.c.name == "parcel_at")
        .order_by(Parcel.name)
    )
    from_tables = (
        sa.select(Parcel.name, Parcel.weight, sql.argument(sql.timelines, 2))
        .join(sql.timelines, sql.argument(sql.timelines, 1) == Parcel.name)
        .join(
            sql.facts,
            (sql.facts.c.kb_id == sql.timelines.c.kb_id) & (sql.facts.c.timeline_id == sql.timelines.c.id),
        )
        .where(sql.facts.c.end_time.is_(None))
        .order_by(Parcel.name)
    )
    with service.connect() as connection:
        expected = [("p1", 2.5, "hall"), ("p2", 7.0, "attic")]
        assert connection.execute(from_view).all() == expected
        assert connection.execute(from_tables).all() == expected


def test_a_missing_argument_is_null(kb, service):
    """The second argument of a fact with one argument is null."""
    held = sql.current_functions
    with service.connect() as connection:
        row = connection.execute(sa.select(sql.argument(held, 1), sql.argument(held, 2))).one()
    assert row == ("kenny", None)


@pytest.mark.parametrize("table", ["facts", "functions", "symbols", "goal_history", "transactions"])
def test_an_argument_of_a_table_without_arguments(table):
    """The error says which table has them."""
    for found in (getattr(sql, table), getattr(sql, table).alias("told")):
        with pytest.raises(ValueError, match=rf"^({table}|told) has no arguments: join sql\.timelines "):
            sql.argument(found, 1)


@pytest.mark.parametrize("position", [0, -1, "1", None])
def test_arguments_are_counted_from_one(position):
    """Any other position is refused before a database sees it."""
    for table in (sql.current_facts, sql.timelines):
        with pytest.raises(ValueError, match=f"1 for the first .*, not {position!r}"):
            sql.argument(table, position)


def test_times_are_nanoseconds_or_datetimes_and_open_ends_are_none(kb, service):
    """A column of time reads as an int, or by `as_datetime`; an open end as None; both are compared with times."""
    kb.remove("(parcel_at p2 attic)", "(robot_at kenny hall)")
    begins, ends = sql.facts.c.initial_time, sql.facts.c.end_time
    with service.connect() as connection:
        rows = connection.execute(
            sa.select(begins, sql.as_datetime(begins), ends, sql.as_datetime(ends)).order_by(ends)
        )
        assert rows.all()[-1] == (seconds(1000), datetime(1970, 1, 1, 0, 16, 40, tzinfo=UTC), None, None)
        for moment in (seconds(1000), datetime(1970, 1, 1, 0, 16, 40, tzinfo=UTC), "1970-01-01T00:16:40Z"):
            assert connection.execute(sa.select(sa.func.count()).where(begins == moment)).scalar() == 3


def test_an_open_end_is_compared_as_the_latest(kb, service):
    """None, in any operator, is the end that has not come: later than every other. Columns are compared as well."""
    end = kb.remove("(parcel_at p2 attic)", "(robot_at kenny hall)").time
    ends, later = sql.facts.c.end_time, sql.facts.alias("later")
    kb.add("(robot_at kenny hall)", initial_time=seconds(2000))
    for condition, count in (
        (ends == None, 2),  # noqa: E711
        (ends.is_(None), 2),
        (ends.is_(sa.null()), 2),
        (ends == sa.bindparam("end", None), 2),
        (ends.in_([None]), 2),
        (ends.in_((None, end)), 4),
        (ends.in_(sa.bindparam("ends", [None], expanding=True)), 2),
        (ends.is_not_distinct_from(None), 2),
        (ends != None, 2),  # noqa: E711
        (ends.is_not(None), 2),
        (ends.not_in([None]), 2),
        (ends.is_distinct_from(None), 2),
        (ends < None, 2),
        (ends >= None, 2),
        (ends.between("1970-01-01T00:00:00Z", None), 4),
        (ends == end, 2),
        (ends <= sa.select(later.c.initial_time).where(later.c.initial_time > end).scalar_subquery(), 2),
        # the clock stands still: they ended when they began
        (ends == sql.facts.c.initial_time, 2),
    ):
        with service.connect() as connection:
            assert connection.execute(sa.select(sa.func.count(sql.facts.c.seq)).where(condition)).scalar() == count, (
                str(condition)
            )


# -- one transaction over both --------------------------------------------------------------------------------


def begun(service):
    """A writing transaction of the service, which SQLite needs begun explicitly."""
    connection = service.connect()
    if service.dialect.name == "sqlite":
        connection.exec_driver_sql("BEGIN IMMEDIATE")
    return connection


def add_in(kb, connection, *items):
    """Add each item by a separate call, in one block on the service's connection."""
    with kb.transaction(connection=connection) as tx:
        for item in items:
            tx.add(item)


def test_a_row_and_a_fact_are_committed_together(kb, service):
    """The service's own row and the added knowledge are in one transaction of the database."""
    with begun(service) as connection:
        connection.execute(sa.insert(Parcel).values(name="p1", weight=2.5))
        connection.execute(sa.insert(Order).values(parcel="p1", place="attic"))
        with kb.transaction(connection=connection, client="orders") as tx:
            tx.add_goal("(parcel_at p1 attic)")
        assert kb.goals() == []
        connection.commit()
    assert [str(goal) for goal in kb.goals()] == ["(parcel_at p1 attic)"]
    with service.connect() as connection:
        assert connection.execute(sa.select(Order.place)).scalar() == "attic"


def test_a_row_and_a_fact_are_rolled_back_together(kb, service):
    """A rollback of the caller undoes both; the next transaction takes the number."""
    before = kb.state().facts
    number = kb.add("(= (battery kenny) 70)").number
    with begun(service) as connection:
        connection.execute(sa.insert(Parcel).values(name="p1", weight=2.5))
        with kb.transaction(connection=connection) as tx:
            tx.remove("(parcel_at p1 hall)")
        connection.rollback()
    assert kb.state().facts == before
    assert kb.holds("(parcel_at p1 hall)")
    with service.connect() as connection:
        assert connection.execute(sa.select(sa.func.count()).select_from(Parcel)).scalar() == 0
    assert kb.remove("(parcel_at p1 hall)").number == number + 1


def test_a_refusal_leaves_the_callers_transaction_usable(kb, service):
    """An exception in the block rolls back the block's own writes, and nothing else."""
    with begun(service) as connection:
        connection.execute(sa.insert(Parcel).values(name="p1", weight=2.5))
        with pytest.raises(kbstore.InvalidKnowledge):
            add_in(kb, connection, "(parcel_at p1 attic)", "(parcel_at p1 kenny)")
        connection.execute(sa.insert(Parcel).values(name="p2", weight=7.0))
        connection.commit()
    assert not kb.holds("(parcel_at p1 attic)")
    with service.connect() as connection:
        assert connection.execute(sa.select(sa.func.count()).select_from(Parcel)).scalar() == 2


def test_a_connection_that_writes_nothing_yet_is_refused_on_sqlite(tmp_path):
    """On SQLite the caller must have begun a writing transaction, or the error says how."""
    engine = sa.create_engine(f"sqlite:///{tmp_path / 'one.db'}")
    with (
        kbstore.open(engine, "post", clock=ManualClock(seconds(1))) as kb,
        engine.connect() as connection,
        pytest.raises(kbstore.KbStoreError, match="BEGIN IMMEDIATE"),
    ):
        add_in(kb, connection, "p1 - parcel")
    engine.dispose()


# -- events ---------------------------------------------------------------------------------------------------


def test_events_of_constructs_and_transactions_are_the_services_own(kb, service):
    """Cursor events show kbstore's statements on an engine that it uses already; the others only those of the service.

    BEGIN, COMMIT and ROLLBACK of kbstore's transactions are not shown.
    """
    seen = {name: [] for name in ("before_cursor_execute", "before_execute", "begin", "commit")}
    for name, found in seen.items():
        sa.event.listen(service, name, lambda *arguments, found=found: found.append(arguments))
    kb.add("(= (battery kenny) 70)")
    assert kb.value("(battery kenny)") == 70
    statements = [statement for _, _, statement, *_ in seen.pop("before_cursor_execute")]
    assert any(statement.startswith("INSERT INTO functions") for statement in statements)
    assert any(statement.startswith("SELECT") for statement in statements)
    assert not [text for text in statements if text.startswith(("BEGIN", "COMMIT", "ROLLBACK"))]
    assert seen == {"before_execute": [], "begin": [], "commit": []}
    with service.begin() as connection:
        connection.execute(sa.select(sql.facts.c.kb_id))
    assert {name: len(found) for name, found in seen.items()} == {"before_execute": 1, "begin": 1, "commit": 1}


# -- FastAPI --------------------------------------------------------------------------------------------------


@pytest.fixture
def client(kb):
    """A client of the service's web interface."""
    testclient = pytest.importorskip("fastapi.testclient", reason="FastAPI is not installed: pip install '.[dev]'")
    from tests.service.app import make_app

    with testclient.TestClient(make_app(kb)) as made:
        yield made


def test_an_item_is_a_body_and_a_transaction_the_answer(client):
    """A KnowledgeItem as the body of a request; the result as the response, by its type."""
    body = {
        "knowledge_type": 1,
        "attribute_name": "parcel_at",
        "values": [{"key": "p", "value": "p1"}, {"key": "w", "value": "attic"}],
    }
    answer = client.post("/knowledge", json=body)
    assert answer.status_code == 200
    assert answer.json()["changes"] == 1
    facts = client.get("/facts", params={"name": "parcel_at"}).json()
    assert sorted(" ".join(value["value"] for value in fact["values"]) for fact in facts) == [
        "p1 attic",
        "p1 hall",
        "p2 attic",
    ]


def test_one_wrong_field_is_one_error_at_its_place(client):
    """A body is discriminated by `knowledge_type`: one error, with its position."""
    answer = client.post("/knowledge", json={"knowledge_type": 1, "attribute_name": 5})
    assert answer.status_code == 422
    (error,) = answer.json()["detail"]
    assert error["loc"][-1] == "attribute_name"


def test_a_history_is_a_response(client):
    """Assertions by their type and without one are the same list."""
    (assertion,) = found = client.get("/history", params={"pattern": "(parcel_at p1 ?)"}).json()
    assert assertion["item"]["attribute_name"] == "parcel_at"
    assert assertion["initial_time"] == seconds(1000)
    assert assertion["end_time"] is None
    assert client.get("/bare-history", params={"pattern": "(parcel_at p1 ?)"}).json() == found


def test_a_state_is_a_response(client):
    """A state named as response model, as annotation, and by nothing is the same object of items."""
    state = client.get("/state").json()
    assert (state["name"], state["at"], state["as_of"]) == ("post", seconds(1000), None)
    assert [fact["attribute_name"] for fact in state["facts"]] == ["parcel_at", "parcel_at", "robot_at"]
    (battery,) = state["functions"]
    assert (battery["attribute_name"], battery["function_value"]) == ("battery", 80)
    assert client.get("/annotated-state").json() == state
    assert client.get("/bare-state").json() == state


def test_plain_data_is_a_response(client):
    """`to_dict` of a state and of a history give items with their PDDL, and times as text."""
    answer = client.get("/plain", params={"pattern": "(parcel_at p1 ?)"}).json()
    assert (answer["state"]["at"], answer["state"]["at_ns"]) == ("1970-01-01T00:16:40Z", seconds(1000))
    assert [assertion["pddl"] for assertion in answer["history"]] == ["(parcel_at p1 hall)"]


def test_openapi_describes_states_and_histories(client):
    """The interface's description has the parts of a state, and the fields of an assertion."""
    api = client.get("/openapi.json").json()

    def schema(path):
        return api["paths"][path]["get"]["responses"]["200"]["content"]["application/json"]["schema"]

    facts = schema("/state")["properties"]["facts"]
    assert (facts["type"], facts["items"]["$ref"]) == ("array", "#/components/schemas/Fact")
    assert "initial_time" in api["components"]["schemas"]["Fact"]["properties"]
    history = schema("/history")
    assert (history["type"], history["items"]["$ref"]) == ("array", "#/components/schemas/Assertion")


def test_openapi_names_the_discriminator(client):
    """The interface's description distinguishes the types of items by their `knowledge_type`."""
    body = client.get("/openapi.json").json()["paths"]["/knowledge"]["post"]["requestBody"]
    assert body["content"]["application/json"]["schema"]["discriminator"]["propertyName"] == "knowledge_type"
