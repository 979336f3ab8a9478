"""Adds more knowledge than fits into memory: batch after batch, each in a transaction of its own."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice

from kbstore.errors import InvalidKnowledge, KbStoreError
from kbstore.model.results import Transaction
from kbstore.reading.questions import Knowledge
from kbstore.writing.unit_of_work import OpenTransaction

BATCH = 10_000
"""The default number of items in one transaction."""

_LISTED = 20
"""The number of a batch's violations that are listed."""

Counted = Callable[[int], None]
"""A function that is called after each batch with the number of items stored so far."""


@dataclass(frozen=True, slots=True, repr=False)
class Ingested(Transaction):
    """The result of ingesting: its last transaction, where `changes` counts what changed in all of them.

    `items` is how many items were read, `batches` how many transactions were recorded; a batch that changed nothing is
    not recorded as one (rule C1).
    """

    items: int = 0
    batches: int = 0


def ingest(
    begin: Callable[[], OpenTransaction], items: Iterable[Knowledge], *, batch: int, progress: Counted | None
) -> Ingested:
    """Add all items; see `KnowledgeBase.ingest`."""
    if batch < 1:
        raise ValueError(f"a batch has at least one item, not {batch}")
    if isinstance(items, str | bytes | Mapping):
        raise InvalidKnowledge(f"{items!r} is one item; ingest takes an iterable of items, add takes one")
    done = batches = changes = 0
    with begin() as nothing_yet:
        pass
    last = nothing_yet.result
    for chunk in _chunks(iter(items), batch):
        with begin() as transaction:
            _add(transaction, chunk, done)
        done += len(chunk)
        last = transaction.result
        batches += bool(last.changes)
        changes += last.changes
        if progress is not None:
            progress(done)
    return Ingested(last.number, last.time, last.client, last.note, changes, done, batches)


def _chunks(items: Iterator[Knowledge], size: int) -> Iterator[list[Knowledge]]:
    while chunk := list(islice(items, size)):
        yield chunk


def _add(transaction: OpenTransaction, chunk: Sequence[Knowledge], before: int) -> None:
    """Add a batch. Errors name the item that is wrong by its number, counted from 1 over all batches."""
    try:
        transaction.add(*chunk)
    except KbStoreError:
        # add them one by one, in the same transaction, to find out which one is wrong
        violations: list[str] = []
        for number, item in enumerate(chunk, before + 1):
            try:
                transaction.add(item)
            except InvalidKnowledge as error:
                violations += [f"item {number:,}: {sentence}" for sentence in error.violations]
            except KbStoreError as error:
                if not violations:
                    error.args = (f"item {number:,} ({_kept(before)}): {error}", *error.args[1:])
                    raise
        if not violations:
            raise
        shown = violations[:_LISTED]
        if len(violations) > len(shown):
            shown.append(f"and {len(violations) - len(shown):,} more in this batch")
        raise InvalidKnowledge(*shown, _kept(before)) from None


def _kept(before: int) -> str:
    return f"nothing from item {before + 1:,} on was stored, the {before:,} items before were"
