"""Two PostgreSQL servers: reading a standby, fail-over, and replicating one knowledge base to another server."""

import re
import shutil
import tempfile
import threading
import time

import pytest

import kbstore
from kbstore import StoreUnavailable
from kbstore.storage import schema, tables
from tests.docs.blocks import ROOT, sql_under
from tests.robustness.servers import Server, until
from tests.transfer.pushes import following, same


@pytest.fixture
def folder():
    """A folder that another user may enter, unlike pytest's own."""
    made = tempfile.mkdtemp(prefix="kb")
    yield f"{made}/"
    shutil.rmtree(made, ignore_errors=True)


@pytest.fixture
def primary(folder):
    server = Server.made(f"{folder}primary")
    yield server
    server.remove()


@pytest.fixture
def standby(primary, folder):
    """A hot standby, without which the primary acknowledges nothing."""
    server = primary.standby(f"{folder}standby")
    primary.run("ALTER SYSTEM SET synchronous_standby_names = '*'", "SELECT pg_reload_conf()")
    until(lambda: primary.run("SELECT 1 FROM pg_stat_replication WHERE sync_state = 'sync'"))
    yield server
    server.remove()


def test_a_standby_is_read_and_watched(primary, standby):
    """`read_only=True` on a hot standby: the same answers, changes as they arrive, and no writes."""
    with kbstore.open(primary.url(), "kenny") as kb:
        kb.load("(define (domain d) (:types room) (:predicates (open ?r - room)) (:functions (level)))")
        kb.add("hall - room", "(open hall)")
        until(lambda: "kenny" in kbstore.knowledge_bases(standby.url()))
        with kbstore.open(standby.url(), "kenny", read_only=True) as replica:
            until(lambda: replica.state().facts == kb.state().facts)
            assert replica.holds("(open hall)")
            assert replica.history("(open ?)") == kb.history("(open ?)")
            watch = replica.watch(after=2, poll=0.01, timeout=30)
            seen = []
            for number in range(20):
                kb.add(f"(= (level) {number})")
                change = next(watch)
                seen.append((change.number, change.asserted[0].item.function_value))
                assert replica.value("(level)") == number
            assert seen == [(number + 3, float(number)) for number in range(20)]
            with pytest.raises(StoreUnavailable, match="read_only=True"):
                replica.add("(open hall)")
        with (
            kbstore.open(standby.url(), "kenny") as replica,
            pytest.raises(StoreUnavailable, match=r"read-only|recovery"),
        ):
            replica.add("(= (level) 7)")


def test_fail_over(primary, standby, folder):
    """The primary is killed, the standby promoted: nothing acknowledged is lost, and the writer works on.

    So does a push that follows a robot's file.
    """
    acknowledged, refused, numbers = [], [], iter(range(10**6))
    ending = threading.Event()

    def write(kb):
        for number in numbers:
            if ending.is_set():
                return
            try:
                acknowledged.append((kb.add(f"(= (level) {number})").number, number))
            except StoreUnavailable as error:
                refused.append(error)
                time.sleep(0.02)

    url = primary.url(standby, target_session_attrs="read-write", connect_timeout=2)
    robot = kbstore.open(f"{folder}robot.db", "lenny")
    with kbstore.open(url, "kenny") as kb, following(robot, url):
        writer = threading.Thread(target=write, args=(kb,))
        writer.start()
        until(lambda: len(acknowledged) >= 100)
        robot.add("(seen before)")
        until(lambda: same(f"{folder}robot.db", url, "lenny"))
        primary.kill()
        robot.add("(seen meanwhile)")
        until(lambda: refused)
        before = len(acknowledged)
        standby.promote()
        until(lambda: len(acknowledged) >= before + 50)
        ending.set()
        writer.join()
        stored = {change.number: change.asserted[0].item.function_value for change in kb.changes()}
        assert [stored[number] for number, _ in acknowledged] == [float(value) for _, value in acknowledged]
        assert len(stored) - len(acknowledged) <= len(refused)
        robot.add("(seen afterwards)")
        until(lambda: same(f"{folder}robot.db", url, "lenny"))


# -- logical replication --------------------------------------------------------------------------------------------


@pytest.fixture
def other(primary, folder):
    """Another server, with the tables of a store."""
    primary.run("CHECKPOINT")
    server = Server.made(f"{folder}other")
    yield server
    server.remove()


def test_one_knowledge_base_is_replicated_and_taken_over(primary, other):
    """By the statements of docs/operations.md: a publication of its rows alone, beside other publications."""
    statements = sql_under(ROOT / "docs" / "operations.md", "One knowledge base by logical replication")
    with kbstore.open(other.url(), "lenny") as lenny, kbstore.open(primary.url(), "kenny") as kb:
        lenny.add("(at lenny dock)")
        with kbstore.open(primary.url(), "monty") as monty:
            monty.add("(at monty dock)")
        kb.load("(define (domain d) (:types room) (:predicates (open ?r - room)) (:functions (level)))")
        kb.add("hall - room", "(open hall)")
        kb.add("(= (level) 3)", initial_time=kb.now() + kbstore.seconds(3600))
        ((number,),) = primary.run("SELECT id FROM knowledge_bases WHERE name = 'kenny'")
        publish, subscribe, state, take_over = (text.replace("1804289383", str(number)) for text in statements)
        named = set(re.findall(r"(\w+) WHERE", publish))
        assert named == {*tables.metadata.tables} - {schema.VERSION_TABLE}
        primary.run(*commands(publish))
        connection = f"host=127.0.0.1 port={primary.port} user=postgres dbname=postgres"
        other.run(*commands(re.sub(r"CONNECTION '[^']*'", f"CONNECTION '{connection}'", subscribe)))
        until(lambda: not other.run(*commands(state)))
        kb.remove("(open hall)")
        kb.add("(open hall)", since=kb.now() - 1)
        kb.clear()
        until(lambda: same(primary.url(), other.url(), "kenny"))
        assert kbstore.knowledge_bases(other.url()) == ["kenny", "lenny"]
        with kbstore.open(other.url(), "kenny", read_only=True) as copy:
            assert copy.history("(open ?)") == kb.history("(open ?)")
        assert lenny.holds("(at lenny dock)")
        latest = max(change.number for change in kb.changes())
    primary.kill()
    other.run(*commands(take_over))
    with kbstore.open(other.url(), "kenny") as copy:
        assert copy.add("kitchen - room", "(open kitchen)").number == latest + 1
        assert copy.holds("(open kitchen)")


def commands(text):
    """The statements of a block, one by one."""
    return [part for part in (part.strip() for part in text.split(";")) if part]
