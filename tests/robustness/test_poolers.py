"""Behind a pooler in transaction mode no client's settings reach another: with a test double, and PgBouncer."""

import os
import select
import shutil
import signal
import subprocess
import tempfile
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import psycopg
import pytest
import sqlalchemy as sa
from sqlalchemy.pool import NullPool

import kbstore
from kbstore.storage.driver_errors import unavailable
from tests.robustness.pooler import pooled

PGBOUNCER = shutil.which("pgbouncer", path=f"{os.environ.get('PATH', '')}:/usr/sbin:/usr/local/sbin")


def server_is_ours(url):
    """Whether the server of the tests listens on a socket where the poolers look for it."""
    return "host" in sa.make_url(url).query


@contextmanager
def bounced(url):
    """The URL of a database through PgBouncer, with one server connection that all clients share."""
    direct = sa.make_url(url)
    with tempfile.TemporaryDirectory(prefix="pb", dir="/tmp") as directory:
        # PgBouncer does not run as root; the owner of the server may connect to the server's socket
        owner = os.stat(direct.query["host"]).st_uid
        os.chown(directory, owner, -1)
        Path(directory, "pgbouncer.ini").write_text(
            f"[databases]\n"
            f"x = host={direct.query['host']} dbname={direct.database} user={direct.username} pool_size=1\n"
            f"[pgbouncer]\npool_mode = transaction\nlisten_addr =\nunix_socket_dir = {directory}\n"
            f"listen_port = 6432\nauth_type = any\nlogfile = {directory}/log\npidfile = {directory}/pid\n"
        )
        command = [PGBOUNCER, "-q", f"{directory}/pgbouncer.ini"]
        if os.geteuid() == 0:
            command = ["setpriv", "--reuid", str(owner), "--clear-groups", *command]
        with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
            try:
                for _ in range(100):
                    if Path(directory, ".s.PGSQL.6432").exists():
                        break
                    time.sleep(0.05)
                yield f"postgresql+psycopg://{direct.username}@/x?host={directory}&port=6432&prepare_threshold=none"
            finally:
                process.send_signal(signal.SIGTERM)
                with suppress(subprocess.TimeoutExpired):
                    process.wait(10)
                process.kill()


@pytest.fixture(params=["double", "pgbouncer"])
def pooled_url(request, empty_database):
    """A URL through a pooler, to a database of its own."""
    if not server_is_ours(empty_database):
        pytest.skip("the server named by KBSTORE_TEST_POSTGRESQL_URL is not reached by a socket of the file system")
    if request.param == "double":
        with pooled(empty_database) as (url, pooler):
            yield url
            assert pooler.transactions > 5
        return
    if PGBOUNCER is None:
        pytest.skip("pgbouncer is not installed (Debian: apt install pgbouncer)")
    with bounced(empty_database) as url:
        yield url


def driver_url(url):
    """The same for psycopg."""
    direct = sa.make_url(url).set(drivername="postgresql").difference_update_query(["prepare_threshold"])
    return direct.render_as_string(hide_password=False)


def session_settings(url):
    """The settings that a new client finds on each of the server's connections."""
    found = set()
    with psycopg.connect(driver_url(url), autocommit=True, prepare_threshold=None) as connection:
        for _ in range(4):
            row = connection.execute(
                "SELECT current_setting('default_transaction_read_only'), current_setting('synchronous_commit'),"
                " current_setting('lock_timeout'), current_setting('search_path')"
            ).fetchone()
            found.add(row)
    return found


def test_settings_of_one_client_do_not_reach_another(pooled_url):
    """Read-only and synchronous_commit are one client's own; others write as before, and no setting is left."""
    before = session_settings(pooled_url)
    with kbstore.open(pooled_url, "pooled") as writer:
        writer.add("(raining)")
        with kbstore.open(pooled_url, "pooled", read_only=True) as reader:
            assert reader.state().holds("(raining)")
            assert reader.holds("(raining)")
            writer.add("(open hall)")
        with kbstore.open(pooled_url, "pooled", durability="normal", busy_timeout=3) as careless:
            careless.add("(open galley)")
            writer.add("(open cellar)")
            assert len(careless.state().facts) == 4
        assert session_settings(pooled_url) == before


def test_an_engine_of_the_callers_through_a_pooler(pooled_url):
    """The same with an engine whose driver prepares no statements."""
    before = session_settings(pooled_url)
    url = sa.make_url(pooled_url).difference_update_query(["prepare_threshold"])
    engine = sa.create_engine(url, connect_args={"prepare_threshold": None}, poolclass=NullPool)
    with kbstore.open(engine, "pooled", durability="normal") as kb:
        kb.add("(raining)")
        with kbstore.open(engine, "pooled", read_only=True) as reader:
            assert reader.holds("(raining)")
        kb.add("(open hall)")
    assert session_settings(pooled_url) == before
    engine.dispose()


def test_nothing_is_prepared_behind_a_pooler(pooled_url):
    """A prepared statement's name may be another client's there; it is noticed, by URL and for any engine.

    A URL with a threshold is obeyed, for poolers that support prepared statements.
    """
    url = sa.make_url(pooled_url).difference_update_query(["prepare_threshold"])
    engine = sa.create_engine(url)
    with (
        kbstore.open(url, "pooled") as kb,
        kbstore.open(engine, "pooled") as lent,
        kbstore.open(engine, "other") as other,
    ):
        for number in range(12):
            kb.add(f"(p a{number})", f"(= (n a{number}) {number})")
            with engine.begin() as connection, other.transaction(connection=connection) as transaction:
                transaction.add(f"(q a{number})")
            for asked in (kb, lent):
                assert asked.holds(f"(p a{number})")
                assert not asked.holds(f"(q a{number})")
                assert asked.value(f"(n a{number})") == number
                assert len(asked.state().facts) == number + 1
        assert len(other.find("(q ?x)")) == 12
        with engine.connect() as connection:
            assert connection.connection.driver_connection.prepare_threshold == 5
    engine.dispose()
    with kbstore.open(url.update_query_dict({"prepare_threshold": "7"})) as kb, kb._database.connect() as connection:
        assert connection.driver.prepare_threshold == 7


def test_the_error_of_mixed_up_prepared_statements():
    """Behind a pooler without support for them, the error has the option to remove."""
    for error in (psycopg.errors.InvalidSqlStatementName, psycopg.errors.DuplicatePreparedStatement):
        assert "leave prepare_threshold out of the URL" in str(unavailable(error("_pg3_0"), "rooms", 30.0))


def test_a_day_behind_a_pooler(pooled_url):
    """Loading, many questions of each kind, history, export: nothing depends on the previous connection."""
    with kbstore.open(pooled_url, "pooled") as kb, kbstore.open(pooled_url, "pooled") as other:
        kb.load("(define (domain d) (:types room) (:predicates (open ?r - room)) (:functions (n)))")
        kb.add("hall - room", "galley - room", "(= (n) 0)")
        for number in range(12):
            kb.add("(open hall)" if number % 2 else "(not (open hall))")
            other.add("(increase (n) 1)")
            assert kb.holds("(open hall)") is bool(number % 2)
            assert kb.value("(n)") == number + 1
        assert len(kb.history("(open hall)")) == 12
        assert len(list(kb.changes())) == 26
        assert kb.state() is not None


def test_an_answer_that_begins_before_all_queries_are_sent(postgresql_url):
    """The double forwards each full buffer of the server, also where the client has not yet asked for the rest."""
    if not server_is_ours(postgresql_url):
        pytest.skip("the server is not in this file system")
    with pooled(postgresql_url) as (url, _), psycopg.connect(driver_url(url), autocommit=True) as connection:
        link = connection.pgconn
        link.enter_pipeline_mode()
        link.send_query_params(b"SELECT repeat('x', 100) FROM generate_series(1, 500)", [])
        link.flush()
        # the server's buffer has 8 kB, and ends within a row
        time.sleep(0.1)
        link.pipeline_sync()
        link.flush()
        answers = []
        while len(answers) < 3:
            while link.is_busy():
                assert select.select([link.socket], (), (), 10)[0], "the double passes nothing on any more"
                link.consume_input()
            answers.append(link.get_result())
        link.exit_pipeline_mode()
        # each query's answer is followed by None, and the last by that of the sync
        assert [len(answers[0].get_value(row, 0)) for row in range(answers[0].ntuples)] == [100] * 500


def test_an_add_takes_five_trips_to_the_server(postgresql_url):
    """It begins, locks the head, reads the state, writes all rows together, and commits."""
    if not server_is_ours(postgresql_url):
        pytest.skip("the server is not in this file system")
    with pooled(postgresql_url) as (url, pooler), kbstore.open(url, "adds") as kb:
        kb.load("(define (domain d) (:predicates (p) (q)))")
        kb.add("(p)")
        kb.remove("(p)")
        before = pooler.trips
        kb.add("(p)")
        assert pooler.trips - before == 5
        assert kb.holds("(p)")


def test_a_state_takes_one_trip_to_the_server(postgresql_url):
    """The state now or at a time is read with the head by one statement; with a schedule, by several at once."""
    if not server_is_ours(postgresql_url):
        pytest.skip("the server is not in this file system")
    with pooled(postgresql_url) as (url, pooler):
        clock = kbstore.ManualClock(10**18)
        with kbstore.open(url, "trips", clock=clock) as kb:
            kb.load(
                "(define (domain d) (:types robot) (:predicates (p ?r - robot) (q ?r - robot)) (:functions (f ?r)))"
            )
            kb.add("r - robot", "(p r)", "(= (f r) 1)")
            clock.advance(kbstore.seconds(10))
            kb.add("(q r)")
            first = 10**18 + 1
            kb.state(at=first)
            before = pooler.trips
            state = kb.state(at=first + 1)
            assert pooler.trips - before == 1
            assert [str(item) for item in (*state.instances, *state.facts, *state.functions)] == [
                "r - robot",
                "(p r)",
                "(= (f r) 1)",
            ]
            before = pooler.trips
            assert len(kb.state().facts) == 2
            assert pooler.trips - before == 1
            before = pooler.trips
            assert kb.holds("(and (p r) (q r))")
            assert pooler.trips - before <= 4
            with kbstore.open(url, "trips", clock=clock) as other:
                # a kind of assertion that this process has not seen, and then a scheduled one
                other.add_metric("minimize (f r)")
                clock.advance(kbstore.seconds(10))
                state = kb.state(at=clock.now() - kbstore.seconds(5))
                assert str(state.metric) == "minimize (f r)"
                other.add("(not (q r))", initial_time=clock.now() + kbstore.seconds(20))
                clock.advance(kbstore.seconds(10))
                state = kb.state(at=clock.now() - kbstore.seconds(5))
                assert [str(item) for item in state.timed_knowledge] == ["(not (q r))"]
                before = pooler.trips
                state = kb.state(at=clock.now() - kbstore.seconds(4))
                # all that holds, or is scheduled; the scheduled rows by their keys; the end of the transaction
                assert pooler.trips - before == 3
                assert [str(item) for item in state.timed_knowledge] == ["(not (q r))"]
