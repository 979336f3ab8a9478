"""Exports a whole knowledge base as JSON Lines, and imports it into any store, on either engine.

The format is that of `kbstore.transfer.jsonl`.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from kbstore.errors import InvalidKnowledge, KbStoreError, StoreUnavailable
from kbstore.names import check_knowledge_base
from kbstore.storage import directory
from kbstore.transfer.consistency import contradictions
from kbstore.transfer.content import Content
from kbstore.transfer.jsonl import JsonLinesReader, JsonLinesWriter
from kbstore.transfer.queries import by_table
from kbstore.transfer.rows import Progress, RowSource, RowTarget, Steps, StoreLike, batches, copy, new_file, opened
from kbstore.transfer.scratch import Scratch, scratch

File = str | os.PathLike[str] | IO[bytes]
"""A path, or a file that is open in binary mode."""


def export_knowledge_base(url: StoreLike, name: str, file: File, *, progress: Progress | None = None) -> int:
    """Write a knowledge base to a file as JSON Lines, as it is at one moment; writers go on meanwhile.

    Args:
        url: the store.
        name: the knowledge base.
        file: a path, which must not exist yet, and appears when everything is written; or a file open in binary mode.
        progress: called repeatedly with the number of rows written and the total.

    Returns:
        The number of rows.

    Raises:
        StoreUnavailable: the store or the file cannot be reached, or there is no such knowledge base.
        InvalidKnowledge: the file exists.
    """
    with opened(url) as database, database.read() as session:
        session.be_patient()
        source = RowSource(session, name)
        with _writing(file) as output:
            return _export(source, output, progress)


def _export(source: RowSource, output: IO[bytes], progress: Progress | None) -> int:
    counts = source.counts()
    steps = Steps(progress, sum(counts.values()))
    writer = JsonLinesWriter(output)
    writer.header(source.name, source.head, counts, use_unknowns=source.use_unknowns)
    for table in by_table:
        for records in batches(source.records(table)):
            writer.records(table, records)
            steps(len(records))
    return writer.end()


def import_knowledge_base(
    url: StoreLike, file: File, name: str | None = None, *, progress: Progress | None = None
) -> str:
    """Restore a knowledge base that was exported, with every time, transaction, run and cancellation as it was.

    The whole file is checked before a row is stored: its rows wait in a temporary file (`TMPDIR`), which takes about as
    much space as they do in an SQLite store. They are stored in one transaction, under the write lock; on SQLite, other
    writers of the store wait for it.

    Args:
        url: the store; an empty database is set up.
        file: a path, or a file open in binary mode.
        name: the name in this store; None: the one that it had.
        progress: called repeatedly with the number of steps done and the total; each row takes two.

    Returns:
        The name under which it was stored.

    Raises:
        InvalidKnowledge: the store has a knowledge base of that name; or the file is not an export, was cut off or
            altered, or has rows that no store can have, and the message names the line.
        SchemaTooNew: the file was written by a newer kbstore.
        StoreUnavailable: the store or the file cannot be reached.
    """
    with _reading(file) as (label, stream):
        lines = JsonLinesReader(stream, label)
        header = lines.header()
        name = header["name"] if name is None else name
        check_knowledge_base(name)
        # each row is read and written twice: into the scratch file, and into the store
        steps = Steps(progress, 2 * sum(header["rows"].values()))
        with opened(url, writing=True) as database:
            with database.connect() as session:
                _refuse_known(name, is_known=directory.find(session, name) is not None)
            with scratch(header["rows"], use_unknowns=header["use_unknowns"]) as rows:
                _judge(lines, rows, steps)
                with database.begin() as session:
                    target = RowTarget(session, name, use_unknowns=header["use_unknowns"])
                    _refuse_known(name, is_known=not target.is_new)
                    copy(rows.source(), target, steps)
                    target.put_head(lines.head)
    return name


def _refuse_known(name: str, *, is_known: bool) -> None:
    if is_known:
        raise InvalidKnowledge(f"the store has a knowledge base {name!r}; import this one under another name")


def _judge(lines: JsonLinesReader, rows: Scratch, steps: Steps) -> None:
    """Read all lines into a scratch file. Raises `InvalidKnowledge` for the first that no store can have written."""
    for table in by_table:
        for records in batches(lines.records(table)):
            rows.add(table, records)
            steps(len(records))
    lines.end()
    rows.finish(lines.head)
    since = lines.head.history_from
    wrong = next(contradictions(rows, since, lines.gone), None) or next(Content(rows, since).contradictions(), None)
    if wrong is not None:
        lines.refuse(rows.line(wrong.table, *wrong.key), wrong.problem)


# -- files --------------------------------------------------------------------------------------------------------


@contextmanager
def _writing(file: File) -> Iterator[IO[bytes]]:
    if not isinstance(file, str | os.PathLike):
        yield file
        return
    with new_file(Path(file)) as partial, open(partial, "wb") as output:
        yield output


@contextmanager
def _reading(file: File) -> Iterator[tuple[str, IO[bytes]]]:
    """Open a file to read, and yield a name for messages with it."""
    if not isinstance(file, str | os.PathLike):
        yield str(getattr(file, "name", "the file")), file
        return
    try:
        with open(file, "rb") as stream:
            yield str(file), stream
    except OSError as error:
        if isinstance(error, KbStoreError):
            raise
        raise StoreUnavailable(f"{os.fspath(file)}: {error.strerror or error}") from error
