"""A stored database file of every schema that there has been: upgraded, asked, downgraded, upgraded again."""

import gzip

import pytest
import sqlalchemy as sa

import kbstore
from kbstore import ManualClock, SchemaOutOfDate, seconds
from kbstore.storage import schema, tables
from tests.migration import stored_mission

REVISIONS = [revision.number for revision in schema.history()]


def stored(revision, path):
    """The stored file of a revision, unpacked."""
    path.write_bytes(gzip.decompress((stored_mission.STORED / f"{revision}.db.gz").read_bytes()))
    return path


def copied(path, revision, url):
    """The rows of a stored file in a database on another engine, with the same schema."""
    schema.upgrade(url, revision)
    source, target = sa.create_engine(f"sqlite:///{path}"), sa.create_engine(url)
    metadata = sa.MetaData()
    with source.connect() as reading, target.begin() as writing:
        metadata.reflect(target, only=lambda name, _: name in tables.metadata.tables)
        for table in metadata.sorted_tables:
            rows = reading.execute(sa.text(f"SELECT * FROM {table.name}")).mappings().all()
            if rows:
                flags = [column.name for column in table.columns if isinstance(column.type, sa.Boolean)]
                writing.execute(table.insert(), [{**row, **{name: bool(row[name]) for name in flags}} for row in rows])
    source.dispose()
    target.dispose()


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request, tmp_path):
    """Put the stored file of a revision into a store on each engine; return its URL."""

    def unpacked(revision):
        path = stored(revision, tmp_path / "store.db")
        if request.param == "sqlite":
            return f"sqlite:///{path}"
        empty = request.getfixturevalue("empty_schema")
        copied(path, revision, empty)
        return empty

    return unpacked


def test_every_schema_has_its_file():
    """A new revision needs a database file."""
    assert sorted(path.name for path in stored_mission.STORED.iterdir()) == [f"{number}.db.gz" for number in REVISIONS]


@pytest.mark.parametrize("revision", REVISIONS)
def test_up_and_down_and_up_again(url, revision):
    """The stored data gives the same answers under today's schema, also after a downgrade and an upgrade."""
    url = url(revision)
    assert schema.current(url) == revision
    for _ in range(2):
        if revision != schema.HEAD:
            with pytest.raises(SchemaOutOfDate, match=f"has schema {revision}.*kbstore db upgrade"):
                kbstore.open(url, stored_mission.NAME)
        schema.upgrade(url, backup=False)
        with kbstore.open(url, stored_mission.NAME, clock=ManualClock(seconds(200)), read_only=True) as kb:
            stored_mission.check_answers(kb)
        schema.downgrade(url, REVISIONS[0] if revision == schema.HEAD else revision, backup=False)
    schema.upgrade(url, backup=False)
    with kbstore.open(url, stored_mission.NAME, clock=ManualClock(seconds(200))) as kb:
        assert kb.add("wp2 - place", "(open wp2)").number == len(stored_mission.CLIENTS) + 1
        stored_mission.check_answers(kb)


def test_the_mission_gives_the_same_answers_today(tmp_path):
    """Today's kbstore plays the mission with the same answers as those that wrote the files."""
    stored_mission.play(tmp_path / "today.db")
    with kbstore.open(tmp_path / "today.db", stored_mission.NAME, clock=ManualClock(seconds(200))) as kb:
        stored_mission.check_answers(kb)
