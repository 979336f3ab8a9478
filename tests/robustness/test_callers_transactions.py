"""Writing inside a transaction of the caller: its rows and its knowledge are committed together, or not at all."""

import threading
from contextlib import suppress

import pytest
import sqlalchemy as sa
from sqlalchemy.orm import DeclarativeBase, Mapped, Session, mapped_column
from sqlalchemy.pool import StaticPool

import kbstore
from kbstore.errors import Conflict, InvalidKnowledge, StoreUnavailable, UnknownSymbol


class Base(DeclarativeBase):
    pass


class Order(Base):
    __tablename__ = "orders"
    id: Mapped[int] = mapped_column(primary_key=True)
    item: Mapped[str]


@pytest.fixture(params=["own url", "same engine", "observed engine"])
def opened_by(request):
    """Whether the knowledge base is opened by URL, or on the engine of the connection.

    An observed engine has a listener for statements, so they run through SQLAlchemy.
    """
    return request.param


def begin_for_writing(engine):
    """Have an engine on SQLite begin transactions for writing, as SQLAlchemy's documentation has it."""

    @sa.event.listens_for(engine, "connect")
    def _no_begin(driver, _):
        driver.isolation_level = None

    @sa.event.listens_for(engine, "begin")
    def _begin(connection):
        connection.exec_driver_sql("BEGIN IMMEDIATE")


@pytest.fixture
def engine(shared_url, opened_by):
    """A service's own engine, with its table; on SQLite transactions begin for writing."""
    engine = sa.create_engine(shared_url)
    if opened_by == "observed engine":
        sa.event.listen(engine, "before_cursor_execute", lambda *_: None)
    if engine.dialect.name == "sqlite":
        begin_for_writing(engine)
    Base.metadata.create_all(engine)
    yield engine
    Base.metadata.drop_all(engine)
    engine.dispose()


@pytest.fixture
def kb(shared_url, engine, opened_by, name):
    """A knowledge base in the same database."""
    with kbstore.open(shared_url if opened_by == "own url" else engine, name, busy_timeout=5) as kb:
        kb.add("(open hall)")
        yield kb


def orders(engine):
    with Session(engine) as session:
        return list(session.scalars(sa.select(Order.item)))


def test_rows_and_knowledge_are_committed_together(kb, engine):
    """A service's row and its knowledge become visible when the caller commits, and not before."""
    with Session(engine) as session:
        session.add(Order(item="cup"))
        session.flush()
        with kb.transaction(connection=session.connection(), client="shop") as transaction:
            transaction.add("(ordered cup)")
            assert transaction.state().holds("(ordered cup)")
        assert (transaction.result.number, transaction.result.client) == (2, "shop")
        assert not kb.holds("(ordered cup)")
        assert len(kb.state().facts) == 1
        session.commit()
    assert kb.holds("(ordered cup)")
    assert orders(engine) == ["cup"]
    assert [change.number for change in kb.changes()] == [1, 2]


def test_rows_and_knowledge_are_rolled_back_together(kb, engine):
    """After the caller's rollback neither is there, and no cache is wrong."""
    with engine.connect() as connection:
        begun = connection.begin()
        connection.execute(sa.insert(Order).values(item="cup"))
        with kb.transaction(connection=connection) as transaction:
            transaction.add("(ordered cup)", "cup - thing")
        with kb.transaction(connection=connection) as transaction:
            assert transaction.holds("(ordered cup)")
            transaction.add("(paid cup)")
        assert transaction.result.number == 3
        begun.rollback()
    assert not kb.holds("(ordered cup)")
    kb.add("(returned saucer)", "(paid saucer)")
    # the numbers of the timelines that were rolled back have been given to others
    for fact, truth in (("(ordered cup)", False), ("(paid cup)", False), ("(paid saucer)", True)):
        assert kb.holds(fact) is truth
    kb.add("(ordered cup)")
    assert kb.holds("(ordered cup)")
    assert [change.number for change in kb.changes()] == [1, 2, 3]
    assert orders(engine) == []


def test_an_exception_leaves_the_callers_transaction_usable(kb, engine):
    """The writes of the block are rolled back to its beginning; the caller continues and commits."""
    with engine.begin() as connection:
        connection.execute(sa.insert(Order).values(item="cup"))
        for error in (InvalidKnowledge, KeyboardInterrupt):
            with suppress(error), kb.transaction(connection=connection) as transaction:
                transaction.add("(ordered cup)")
                connection.execute(sa.insert(Order).values(item="saucer"))
                raise error
        with kb.transaction(connection=connection) as transaction:
            assert not transaction.holds("(ordered cup)")
            transaction.add("(ordered plate)")
        connection.execute(sa.insert(Order).values(item="plate"))
    assert {str(fact) for fact in kb.state().facts} == {"(open hall)", "(ordered plate)"}
    assert orders(engine) == ["cup", "plate"]


def test_a_domain_can_be_rolled_back(kb, engine):
    """D4: another domain may be loaded after one that was not committed, and questions use the new one."""
    domain = "(define (domain {0}) (:types room) (:predicates (open ?r - room) ({0})))"
    with engine.connect() as connection:
        begun = connection.begin()
        with kb.transaction(connection=connection) as transaction:
            transaction.clear()
            transaction.load(domain.format("first"))
            transaction.add("(first)")
            assert transaction.holds("(first)")
        with kb.transaction(connection=connection) as transaction:
            assert transaction.holds("(first)")
        begun.rollback()
    with pytest.raises(UnknownSymbol, match="has no domain"):
        kb.domain.name  # noqa: B018
    kb.clear()
    kb.load(domain.format("second"))
    kb.add("(second)")
    assert kb.holds("(second)")
    assert kb.domain.name == "second"


def test_expect_is_checked_and_other_writers_wait(kb, engine, shared_url):
    """`expect` is checked here, too; another writer waits until the caller has committed, and then continues."""
    with engine.begin() as connection:
        with pytest.raises(Conflict), kb.transaction(connection=connection, expect=0):
            pass
        with kb.transaction(connection=connection, expect=1) as transaction:
            transaction.add("(ordered cup)")
        with kbstore.open(shared_url, kb.name, busy_timeout=10) as other:
            writer = threading.Thread(target=other.add, args=("(ordered saucer)",))
            writer.start()
            writer.join(0.2)
            assert writer.is_alive()
            connection.commit()
            writer.join(10)
            assert [change.number for change in other.changes()] == [1, 2, 3]


def test_one_transaction_at_a_time_in_a_thread(kb, engine):
    """Writing through the knowledge base inside the block is refused at once, as in any transaction."""
    with (
        engine.begin() as connection,
        kb.transaction(connection=connection),
        pytest.raises(Conflict, match="a transaction is open in this thread"),
    ):
        kb.add("(ordered cup)")


@pytest.mark.parametrize("observed", ["engine", "connection"])
def test_the_callers_listeners_see_every_statement(kb, engine, observed):
    """Between SAVEPOINT and RELEASE, a listener of the engine or of the connection sees what kbstore runs."""
    seen = []
    with engine.connect() as connection, connection.begin():
        place = engine if observed == "engine" else connection
        sa.event.listen(
            place, "before_cursor_execute", lambda _c, _cursor, text, *_: seen.append(text.split(" FROM")[0])
        )
        with kb.transaction(connection=connection) as transaction:
            transaction.add("(ordered cup)", "(ordered saucer)")
            transaction.remove("(open hall)")
            assert transaction.holds("(ordered cup)")
            assert len(transaction.state().facts) == 2
        connection.execute(sa.insert(Order).values(item="cup"))
    kinds = [text for text in seen if text.startswith(("SAVEPOINT", "RELEASE", "INSERT", "UPDATE facts"))]
    assert kinds[0].startswith("SAVEPOINT")
    assert kinds[-2].startswith("RELEASE")
    assert kinds[-1].startswith("INSERT INTO orders")
    between = "\n".join(kinds[1:-2])
    for part in ("INSERT INTO facts", "UPDATE facts", "INSERT INTO timelines", "INSERT INTO transactions"):
        assert part in between
    assert kb.holds("(ordered saucer)")
    assert orders(engine) == ["cup"]


@pytest.mark.parametrize("is_observed", [False, True])
def test_no_reader_begins_to_write(path, is_observed):
    """On an engine whose transactions begin for writing, kbstore opens and reads a file while another one writes."""
    with kbstore.open(path, "robot") as writer:
        writer.add("(open hall)")
        engine = sa.create_engine(f"sqlite:///{path}", connect_args={"timeout": 0})
        begin_for_writing(engine)
        if is_observed:
            sa.event.listen(engine, "before_cursor_execute", lambda *_: None)
        with writer.transaction() as transaction:
            transaction.remove("(open hall)")
            with kbstore.open(engine, "robot", busy_timeout=0) as reader:
                assert reader.holds("(open hall)")
                assert len(reader.state().facts) == 1
    engine.dispose()


# -- connections that do not do -----------------------------------------------------------------------------------


def enter(kb, connection):
    with kb.transaction(connection=connection) as transaction:
        transaction.add("(ordered cup)")


def test_on_sqlite_the_caller_must_have_begun_to_write(path):
    """Without a transaction, or in one that began by reading while others wrote, the error says how to begin it."""
    engine = sa.create_engine(f"sqlite:///{path}", connect_args={"timeout": 0.1})
    with kbstore.open(path) as kb:
        kb.add("(open hall)")
        with engine.connect() as connection:
            with pytest.raises(StoreUnavailable, match=r"no transaction under way .*BEGIN IMMEDIATE"):
                enter(kb, connection)
            connection.exec_driver_sql("BEGIN")
            connection.exec_driver_sql("SELECT count(*) FROM facts").scalar()
            kb.add("(open galley)")
            with pytest.raises(StoreUnavailable, match=r"cannot write .*BEGIN IMMEDIATE"):
                enter(kb, connection)
            connection.rollback()
            connection.exec_driver_sql("BEGIN IMMEDIATE")
            enter(kb, connection)
            connection.commit()
        # the driver begins before the first change
        with engine.begin() as connection:
            connection.exec_driver_sql("CREATE TABLE own (a)")
            connection.exec_driver_sql("INSERT INTO own VALUES (1)")
            enter(kb, connection)
        assert kb.holds("(ordered cup)")
    engine.dispose()


def test_on_postgresql_the_isolation_must_be_read_committed(postgresql_url, name):
    """A transaction that could not see the writes made while it waited is refused; so is none at all."""
    engine = sa.create_engine(postgresql_url)
    with kbstore.open(engine, name) as kb:
        for level, refusal in (("REPEATABLE READ", "repeatable read"), ("SERIALIZABLE", "serializable")):
            with (
                engine.connect().execution_options(isolation_level=level) as connection,
                pytest.raises(StoreUnavailable, match=rf"{refusal}.* isolation_level='READ COMMITTED'"),
            ):
                enter(kb, connection)
        with (
            engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection,
            pytest.raises(StoreUnavailable, match="in autocommit"),
        ):
            enter(kb, connection)
        # an unused connection begins by itself
        with engine.connect() as connection:
            enter(kb, connection)
            assert not kb.holds("(ordered cup)")
            connection.commit()
        assert kb.holds("(ordered cup)")
    engine.dispose()


def test_a_connection_to_another_database_is_refused(path, postgresql_url, empty_database, name):
    """Writes to another file, another database or another kind of database are refused."""
    other_path = path.with_name("other.db")
    other_file = f"sqlite:///{other_path}"
    places = [(path, other_file), ("sqlite://", other_file), (postgresql_url, empty_database)]
    for url in (other_path, empty_database):
        kbstore.open(url, name).close()
    for url, elsewhere in places:
        engine = sa.create_engine(elsewhere)
        with kbstore.open(url, name) as kb, engine.connect() as connection:
            if engine.dialect.name == "sqlite":
                connection.exec_driver_sql("BEGIN IMMEDIATE")
            with pytest.raises(StoreUnavailable, match="another database"):
                enter(kb, connection)
        engine.dispose()
    engine = sa.create_engine(postgresql_url)
    with kbstore.open(path, name) as kb, engine.connect() as connection:
        with pytest.raises(StoreUnavailable, match="is to postgresql"):
            enter(kb, connection)
        with Session(engine) as session, pytest.raises(TypeError, match=r"session\.connection\(\)"):
            enter(kb, session)
    engine.dispose()


def test_the_one_connection_of_a_pool(name):
    """In memory the caller's transaction is on the only connection: kbstore uses it, and does not end it."""
    engine = sa.create_engine("sqlite://", poolclass=StaticPool, connect_args={"check_same_thread": False})
    with kbstore.open(engine, name) as kb:
        kb.add("(open hall)")
        with engine.connect() as connection:
            connection.exec_driver_sql("BEGIN IMMEDIATE")
            enter(kb, connection)
            with pytest.raises(StoreUnavailable, match="transaction is under way"):
                kb.holds("(ordered cup)")
            connection.rollback()
        assert not kb.holds("(ordered cup)")
    engine.dispose()


def test_a_schema_of_its_own(postgresql_url, name):
    """The caller's transaction has its own search path, which stays."""
    engine = sa.create_engine(postgresql_url)
    with kbstore.open(engine, name, schema=name) as kb, engine.begin() as connection:
        enter(kb, connection)
        assert connection.exec_driver_sql("SHOW search_path").scalar() == '"$user", public'
        assert connection.exec_driver_sql(f'SELECT count(*) FROM "{name}".facts').scalar() == 1
        connection.exec_driver_sql(f'DROP SCHEMA "{name}" CASCADE')
    engine.dispose()
