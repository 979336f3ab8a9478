"""Peers are given the same history as kbstore, and give the same answers; needs the extra `bench`."""

import contextlib
import itertools
import sqlite3
import warnings

import pytest
import sqlalchemy as sa
from sqlalchemy.dialects import sqlite

from benchmarks.histories import PASSING, SHAPES, START, STEP, UNIFORM, History
from benchmarks.peers.comparing import PEERS
from benchmarks.peers.peer import Change, changes

_SIZE = 1300


@pytest.fixture(params=PEERS, ids=lambda kind: kind.name)
def kind(request):
    """Each installed peer."""
    name = {"duck": "duckdb", "continuum": "sqlalchemy_continuum", "sourced": "eventsourcing"}
    pytest.importorskip(name[request.param.module], reason=f"pip install {request.param.distribution}")
    return request.param


@pytest.fixture
def make(kind, tmp_path):
    """Make new peers, and close them after the test."""
    made = []

    def making():
        with warnings.catch_warnings():
            # warnings of other libraries during their import are not kbstore's
            warnings.simplefilter("ignore")
            made.append(kind.make(tmp_path / f"peer{len(made)}.db"))
        return made[-1]

    yield making
    for peer in made:
        peer.close()


@pytest.mark.parametrize("shape", [UNIFORM, PASSING])
def test_a_peer_answers_state_and_point_queries_rightly(make, shape):
    """At six times a peer's state is that of the changes up to then, and a point query agrees with it."""
    history = History(shape, _SIZE)
    peer = make()
    peer.tell(changes(history))
    for t in history.moments():
        expected = _replayed(history, t)
        assert peer.state(t) == expected
        for key in list(expected)[::250]:
            assert peer.point(key, t) is not expected[key]
        assert peer.point("seen nobody", t) is False


def test_a_peer_takes_single_changes_and_many_facts(make):
    """A fact changes its sign from a time on and not before; new facts hold from a time on and not before."""
    history = History(UNIFORM, _SIZE)
    peer = make()
    peer.tell(changes(history))
    t = START + _SIZE * STEP
    before = peer.state(t)
    key = next(iter(before))
    peer.write(Change(t + STEP, key, not before[key]))
    peer.bulk(["seen cup", "seen jug"], t + 2 * STEP)
    assert peer.state(t) == before
    assert peer.state(t + STEP) == {**before, key: not before[key]}
    assert peer.state(t + 2 * STEP) == {**before, key: not before[key], "seen cup": False, "seen jug": False}
    assert peer.point("seen cup", t + 2 * STEP)
    assert not peer.point("seen cup", t + STEP)


def test_rows_written_directly_for_continuum_are_those_of_its_session(tmp_path):
    """Change by change, the versions are the same."""
    pytest.importorskip("sqlalchemy_continuum", reason="pip install SQLAlchemy-Continuum")
    from benchmarks.peers.continuum import Continuum

    signs = (("seen cup", False), ("seen jug", False), ("seen cup", True), ("seen jug", True))
    history = [Change(START + step * STEP, *sign) for step, sign in enumerate(signs)]
    direct, session = Continuum(tmp_path / "direct.db"), Continuum(tmp_path / "session.db")
    direct.tell(history)
    for change in history[:2]:
        session.bulk([change.key], change.time)
    for change in history[2:]:
        session.write(change)
    for peer in (direct, session):
        peer.close()
    versions = "SELECT key, is_negative, transaction_id, end_transaction_id, operation_type FROM fact_version"
    transactions = 'SELECT id, issued_at, remote_addr FROM "transaction" ORDER BY 1'
    for query in (f"{versions} ORDER BY 1, 3", "SELECT key, is_negative FROM fact ORDER BY 1", transactions):
        written = _rows(tmp_path / "direct.db", query)
        assert written
        assert written == _rows(tmp_path / "session.db", query)


def test_a_peer_leaves_the_types_of_others_alone(make):
    """Event handlers that a library adds for its own tables change no table of kbstore's in the same process."""
    make()
    assert sa.BigInteger().compile(dialect=sqlite.dialect()) == "BIGINT"


@pytest.mark.parametrize("shape", SHAPES)
def test_changes_keep_to_a_thousand_facts(shape):
    """With any changes, a thousand facts hold after each time, and times only grow."""
    holding = set()
    last = 0
    for time, group in itertools.groupby(changes(History(shape, _SIZE)), key=lambda change: change.time):
        assert time > last
        last = time
        for _, key, is_negative in group:
            if is_negative is None:
                holding.remove(key)
            else:
                holding.add(key)
        assert len(holding) == 1000


def _replayed(history, t):
    """The state after the changes up to a time, by applying all of them."""
    holding = {}
    for time, key, is_negative in changes(history):
        if time > t:
            break
        holding.pop(key, None)
        if is_negative is not None:
            holding[key] = is_negative
    return holding


def _rows(path, query):
    with contextlib.closing(sqlite3.connect(path)) as connection:
        return connection.execute(query).fetchall()
