"""Export and import: exactly the same, on either engine; nothing at all of a file that is not whole."""

import gzip
import io
import json
import random
import tracemalloc
from pathlib import Path

import pytest

import kbstore
from kbstore import InvalidKnowledge, ManualClock, SchemaTooNew, StoreUnavailable, seconds
from kbstore.transfer import rows as transfer
from kbstore.transfer.jsonl import VERSION
from tests.migration import stored_mission
from tests.transfer.mutations import sealed, unsealed
from tests.transfer.random_histories import DOMAIN, START, answers, live


@pytest.fixture(scope="module")
def sqlite_url(tmp_path_factory):
    """The URL of an SQLite store."""
    return f"sqlite:///{tmp_path_factory.mktemp('interchange') / 'store.db'}"


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request):
    """The URL of a store on each engine that can be named by one."""
    return request.getfixturevalue(f"{request.param}_url")


@pytest.fixture
def other_url(url, request):
    """The URL of a store on the other engine."""
    return request.getfixturevalue("sqlite_url" if url.startswith("postgresql") else "postgresql_url")


def exported(url, name):
    """A knowledge base as its export."""
    output = io.BytesIO()
    kbstore.export_knowledge_base(url, name, output)
    return output.getvalue()


@pytest.fixture(scope="module")
def lived(sqlite_url):
    """A knowledge base after random transactions, exported."""
    clock = ManualClock(START)
    with kbstore.open(sqlite_url, "lived", clock=clock) as kb:
        for _ in live(kb, clock, 3, 80):
            pass
    text = exported(sqlite_url, "lived")
    assert all(json.loads(text.splitlines()[0])["rows"][table] for table in ("expressions", "runs"))
    return text


@pytest.mark.parametrize("seed", [11, 12])
def test_everything_comes_back(url, other_url, tmp_path, seed):
    """An import on the other engine gives the same answers, and the same export, byte by byte; and back again."""
    clock, name = ManualClock(START), f"exported {seed} {url[:4]}"
    with kbstore.open(url, name, clock=clock) as kb:
        for _ in live(kb, clock, seed, 40, late=bool(seed % 2)):
            pass
        kb.archive(START + seconds(5), tmp_path / "archive.db")
        first, latest = START + seconds(5), list(kb.changes(answered(kb)))[-1].time
        expected = answers(kb, first, latest, answered(kb))
    rows = kbstore.export_knowledge_base(url, name, tmp_path / "exported.jsonl")
    text = (tmp_path / "exported.jsonl").read_bytes()
    assert rows == text.count(b"\n") - 2
    assert kbstore.import_knowledge_base(other_url, tmp_path / "exported.jsonl") == name
    assert exported(other_url, name) == text
    with kbstore.open(other_url, name, clock=clock) as kb:
        assert kb.history_from == first
        assert answers(kb, first, latest, answered(kb)) == expected
        number = kb.add("new - robot", "(= (battery new) 1)").number
        assert [change.number for change in kb.changes(number - 1)] == [number]
    again = f"{name} again"
    assert kbstore.import_knowledge_base(url, io.BytesIO(text), again) == again
    assert exported(url, again).count(b"\n") == text.count(b"\n")


def answered(kb):
    """The number of the last transaction that has been archived."""
    for number in range(1000):
        try:
            next(kb.changes(number), None)
        except kbstore.HistoryUnavailable:
            continue
        return number
    return None


def test_the_start_conditions_of_a_run_are_exported(url, other_url):
    """O3: an import between start and end; the line of the run has the conditions that were true, readable."""
    clock, name = ManualClock(START), f"on the way from {url[:4]}"
    with kbstore.open(url, name, clock=clock) as kb:
        kb.load(DOMAIN)
        kb.add(
            "a - place", "r - robot", "s - robot", "(lit)", "(= (cost) 0)", "(= (battery r) 50)", "(= (battery s) 50)"
        )
        kb.start("work", "r", "a", duration=seconds(9))
        kb.remove("(lit)")
        kb.start("work", "s", "a", duration=seconds(9))
    text = exported(url, name)
    lines = [json.loads(line) for line in text.splitlines()]
    assert [line.get("remembered") for line in lines if line.get("table") == "runs"] == ["(lit)", None]
    kbstore.import_knowledge_base(other_url, io.BytesIO(text))
    clock.advance(seconds(10))
    with kbstore.open(other_url, name, clock=clock) as kb:
        for run in kb.state().running:
            kb.end(run)
        assert [str(fact) for fact in kb.state().facts if fact.attribute_name == "near"] == ["(near r a)"]


def test_the_properties_of_a_knowledge_base_are_exported(sqlite_url, tmp_path):
    """An open world without a domain stays one, with the arities of its symbols."""
    with kbstore.open(sqlite_url, "open world", clock=ManualClock(5), use_unknowns=True) as kb:
        kb.add("(Near Kenny WP0)", "(= (weight Kenny) 1e-300)", note="naïve ☃")
    kbstore.export_knowledge_base(sqlite_url, "open world", tmp_path / "file")
    kbstore.import_knowledge_base(tmp_path / "new.db", tmp_path / "file", "renamed")
    assert kbstore.knowledge_bases(tmp_path / "new.db") == ["renamed"]
    with kbstore.open(tmp_path / "new.db", "renamed", clock=ManualClock(6)) as kb:
        assert kb.use_unknowns
        assert [str(fact) for fact in kb.state().facts] == ["(Near Kenny WP0)"]
        assert kb.value("(weight kenny)") == 1e-300
        assert next(kb.changes()).transaction.note == "naïve ☃"
        with pytest.raises(InvalidKnowledge, match="near"):
            kb.add("(near kenny)")


def test_lines_are_plain_json(lived):
    """Each line is JSON with the name of its table; an absent end time is an open one."""
    header, *rows, end = map(json.loads, lived.splitlines())
    assert (header["name"], header["version"]) == ("lived", 1)
    assert end["end"] == len(rows) == sum(header["rows"].values())
    robots = [row for row in rows if row["table"] == "instances" and row["instance_type"] == "robot"]
    assert {row["initial_time"] for row in robots} >= {START}
    assert any("end_time" not in row for row in rows if row["table"] == "facts")


def test_every_version_of_the_format_is_read(tmp_path):
    """A file of each version of the format restores the mission that it records."""
    stored = Path(__file__).parent / "stored"
    assert [path.name for path in stored.iterdir()] == [f"{version}.jsonl" for version in range(1, VERSION + 1)]
    for path in stored.iterdir():
        kbstore.import_knowledge_base(tmp_path / "store.db", path)
        with kbstore.open(tmp_path / "store.db", stored_mission.NAME, clock=ManualClock(seconds(200))) as kb:
            stored_mission.check_answers(kb)


def test_the_file_may_be_compressed_or_a_pipe(sqlite_url, lived, tmp_path):
    """Any file open in binary mode is accepted; one open as text is refused."""
    with gzip.open(tmp_path / "lived.gz", "wb") as output:
        kbstore.export_knowledge_base(sqlite_url, "lived", output)
    with gzip.open(tmp_path / "lived.gz", "rb") as stream:
        kbstore.import_knowledge_base(tmp_path / "new.db", stream)
    assert exported(tmp_path / "new.db", "lived") == lived
    with pytest.raises(InvalidKnowledge, match="binary mode"):
        kbstore.import_knowledge_base(tmp_path / "new.db", io.StringIO(lived.decode()), "text")


def test_progress_is_reported(sqlite_url, lived):
    """Progress rises to the number of rows; an import reads each row, and then writes it."""
    out, back = [], []
    kbstore.export_knowledge_base(sqlite_url, "lived", io.BytesIO(), progress=lambda *step: out.append(step))
    kbstore.import_knowledge_base("sqlite://", io.BytesIO(lived), progress=lambda *step: back.append(step))
    rows = lived.count(b"\n") - 2
    assert out == sorted(out)
    assert out[-1] == (rows, rows)
    assert back == sorted(back)
    assert (rows, 2 * rows) in back
    assert back[-1] == (2 * rows, 2 * rows)


# -- refusals -----------------------------------------------------------------------------------------------------


def refusal(url, lines, name="refused"):
    """The message with which an import is refused; nothing of it may have been stored."""
    with pytest.raises(InvalidKnowledge) as refused:
        kbstore.import_knowledge_base(url, io.BytesIO(lines), name)
    assert name not in kbstore.knowledge_bases(url)
    return str(refused.value)


def test_an_existing_name_is_refused(url, lived):
    """An existing knowledge base is not overwritten, and stays as it was."""
    name = f"there already {url[:4]}"
    with kbstore.open(url, name, clock=ManualClock(5)) as kb:
        kb.add("(here)")
    with pytest.raises(InvalidKnowledge, match="import this one under another name"):
        kbstore.import_knowledge_base(url, io.BytesIO(lived), name)
    with kbstore.open(url, name, clock=ManualClock(6)) as kb:
        assert [str(fact) for fact in kb.state().facts] == ["(here)"]


def test_a_file_that_was_cut_off(url, lived):
    """A file that ends after any line, or within one, is refused with the number of the line."""
    lines = lived.splitlines(keepends=True)
    chance = random.Random(1)
    for kept in (0, 1, *chance.sample(range(2, len(lines)), 4), len(lines) - 1):
        assert f"line {kept + 1} is missing" in refusal(url, b"".join(lines[:kept]))
    for n in chance.sample(range(1, len(lines)), 4):
        half = lines[n][: chance.randrange(1, len(lines[n]) - 1)]
        assert f"line {n + 1} was cut off" in refusal(url, b"".join([*lines[:n], half]))


def test_a_file_that_was_altered(url, lived):
    """A changed byte, and missing, repeated, exchanged or added lines, are found at their line."""
    lines = lived.splitlines(keepends=True)
    chance = random.Random(2)
    for _ in range(8):
        number = chance.randrange(len(lines))
        line = bytearray(lines[number])
        line[chance.randrange(len(line) - 1)] ^= 1 << chance.randrange(7)
        assert f"line {number + 1} " in refusal(url, b"".join([*lines[:number], line, *lines[number + 1 :]]))
    n = len(lines) // 2
    assert f"line {n + 1} was cut off or altered" in refusal(url, b"".join([*lines[:n], *lines[n + 1 :]]))
    assert f"line {n + 2} was cut off or altered" in refusal(url, b"".join([*lines[: n + 1], *lines[n:]]))
    assert f"line {n + 1} was cut off" in refusal(url, b"".join([*lines[:n], lines[n + 1], lines[n], *lines[n + 2 :]]))
    assert f"line {len(lines) + 1} comes after the last one" in refusal(url, lived + lines[-1])


def changed(lived, table, values):
    """The export with other values in the last row of a table, with new checksums; and the number of that line."""
    lines = unsealed(lived)
    number = max(number for number, line in enumerate(lines) if line.get("table") == table)
    lines[number] = {name: value for name, value in (lines[number] | values).items() if value is not None}
    return sealed(lines), number + 1


@pytest.mark.parametrize(
    ("table", "values"),
    [
        ("facts", {"timeline_id": 10**6}),
        ("facts", {"timeline_id": 1}),
        ("facts", {"recorded_tx": 10**6}),
        ("facts", {"cancelled_tx": 10**6}),
        ("facts", {"initial_time": 2**62}),
        ("facts", {"initial_time": -1}),
        ("facts", {"initial_time": "now"}),
        ("facts", {"initial_time": 10**30}),
        ("facts", {"is_negative": 1}),
        ("facts", {"end_cause": 99}),
        ("facts", {"recorded_tx": None}),
        ("facts", {"weather": "fine"}),
        ("facts", {"table": "songs"}),
        ("functions", {"rate": float("nan")}),
        ("functions", {"function_value": 1}),
        ("expressions", {"expr": "\ud800"}),
        ("timelines", {"role": 7}),
        ("timelines", {"id": 1}),
        ("timelines", {"spelling": "something else"}),
        ("transactions", {"number": 1}),
        ("transactions", {"number": 10**6}),
        ("transactions", {"recorded_time": 5}),
        ("transactions", {"recorded_time": 2**61}),
        ("domains", {"version": 9}),
        ("domains", {"sensed": "["}),
        ("runs", {"outcome": "vanished"}),
        ("runs", {"number": 10**6}),
    ],
)
def test_values_that_no_store_has_are_refused(lived, table, values):
    """Values that no store has are refused with the line, even with valid checksums."""
    text, number = changed(lived, table, values)
    with pytest.raises(InvalidKnowledge, match=f"line {number} "):
        kbstore.import_knowledge_base("sqlite://", io.BytesIO(text))


@pytest.mark.parametrize(
    ("lines", "refused"),
    [
        (["{" + '"a": ' + "[" * 100_000 + "]" * 100_000 + "}"], "line 1 is not JSON"),
        (["[1, 2]"], "line 1 is not JSON"),
        (['{"a": ' + "9" * 10_000 + "}"], "line 1 is not JSON"),
        ([{"format": "songs", "version": 1}], "line 1 is not the beginning of an export"),
        ([{"format": "kbstore knowledge base", "version": 1}], "line 1 is not a header"),
        ([{"format": "kbstore knowledge base", "version": "1"}], "line 1 is not the beginning"),
    ],
    ids=["deep", "a list", "a long number", "another format", "no header", "a version that is no number"],
)
def test_an_invalid_first_line_is_refused(lines, refused):
    """Anything that is not a header is refused."""
    with pytest.raises(InvalidKnowledge, match=refused):
        kbstore.import_knowledge_base("sqlite://", io.BytesIO(sealed(lines)))


def test_a_newer_format_is_refused():
    """A file of a later version of the format is SchemaTooNew: the error says to upgrade."""
    text = sealed([{"format": "kbstore knowledge base", "version": 2}])
    with pytest.raises(SchemaTooNew, match="version 2 of the format, this kbstore reads 1; upgrade kbstore"):
        kbstore.import_knowledge_base("sqlite://", io.BytesIO(text))


def test_invalid_files_and_names(sqlite_url, lived, tmp_path):
    """Nothing is overwritten or created, and errors name files that cannot be written or read."""
    (tmp_path / "there").write_text("precious")
    with pytest.raises(InvalidKnowledge, match="exists, and is not overwritten"):
        kbstore.export_knowledge_base(sqlite_url, "lived", tmp_path / "there")
    with pytest.raises(StoreUnavailable, match=r"no knowledge base 'nobody' in this store; there is: .*lived"):
        kbstore.export_knowledge_base(sqlite_url, "nobody", tmp_path / "nobody")
    with pytest.raises(StoreUnavailable, match="there is no store at"):
        kbstore.export_knowledge_base(tmp_path / "missing.db", "lived", tmp_path / "missing")
    with pytest.raises(StoreUnavailable, match="No such file or directory"):
        kbstore.export_knowledge_base(sqlite_url, "lived", tmp_path / "nowhere" / "file")
    with pytest.raises(StoreUnavailable, match="No such file or directory"):
        kbstore.import_knowledge_base(sqlite_url, tmp_path / "missing")
    with pytest.raises(InvalidKnowledge, match="line 1 is not the beginning of an export"):
        kbstore.import_knowledge_base(sqlite_url, tmp_path / "there")
    assert [path.name for path in tmp_path.iterdir()] == ["there"]
    assert (tmp_path / "there").read_text() == "precious"


def test_an_export_that_fails_leaves_no_file(sqlite_url, lived, tmp_path):
    """The file appears when it is complete; an interrupted export leaves nothing."""

    def interrupt(*_):
        assert list(tmp_path.iterdir())
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        kbstore.export_knowledge_base(sqlite_url, "lived", tmp_path / "lived.jsonl", progress=interrupt)
    assert not list(tmp_path.iterdir())


# -- others at work -----------------------------------------------------------------------------------------------


def test_writers_do_not_wait_for_an_export(url, tmp_path):
    """An export has the state of one time: later writes are not in it, and do not wait for it."""
    name = f"busy {url[:4]}"
    clock = ManualClock(5)
    with kbstore.open(url, name, clock=clock) as kb:
        kb.add("(= (one) 1)", "(= (two) 1)")
        before = exported(url, name)

        def write(*_):
            with kbstore.open(url, name, clock=clock) as writer:
                writer.add("(increase (one) 1)", "(increase (two) 1)")

        output = io.BytesIO()
        kbstore.export_knowledge_base(url, name, output, progress=write)
        assert kb.value("(one)") == kb.value("(two)") > 1
    assert output.getvalue() == before


def test_memory_does_not_grow(tmp_path, monkeypatch):
    """Exporting and importing hold some rows at a time: their memory does not grow with the history."""
    monkeypatch.setattr(transfer, "BATCH", 50)
    target = f"sqlite:///{tmp_path / 'target.db'}"
    kbstore.open(target).close()
    peaks = {}
    for rows in (200, 200, 2000):
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}"
        with kbstore.open(path, "long", clock=(clock := ManualClock(5))) as kb:
            for _ in range(rows // 200):
                clock.advance(1)
                kb.update([(0, f"(= (level a{number}) {clock.now()})") for number in range(200)])
        tracemalloc.start()
        kbstore.export_knowledge_base(path, "long", file := path.with_suffix(".jsonl"))
        kbstore.import_knowledge_base(target, file, path.name)
        peaks[rows] = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert file.stat().st_size > 350_000
    assert peaks[2000] < peaks[200] + 100_000
