"""Server-sent events: changes, and updates of the timeline's page."""

import asyncio
import html
from collections.abc import AsyncIterator, Callable
from time import monotonic
from typing import Annotated, Any
from urllib.parse import urlencode

from fastapi import APIRouter, Header, Query
from fastapi.responses import HTMLResponse, StreamingResponse

import kbstore
from kbstore import aio
from kbstore.report.timeline.data import timeline_data
from kbstore.report.timeline.page import as_json, page
from kbstore.serve import answers
from kbstore.serve.answers import Shape
from kbstore.serve.parameters import LONGEST, MOST_NUMBER, Kb, Since, TheStore, moment
from kbstore.serve.questions import page_of
from kbstore.serve.store import Store

POLL = 0.1
"""Seconds between two looks at the store."""

HEARTBEAT = 1.0
"""Seconds between two events with the time; a stream of changes sends a comment after 15 times as many."""

MOST_SHOWN = 5000
"""The number of transactions, the latest, that the page shows if no span is asked for."""

Patterns = Annotated[list[str] | None, Query(max_length=100)]
LastEvent = Annotated[str | None, Header(alias="Last-Event-ID", max_length=20, include_in_schema=False)]

router = APIRouter()
pages = APIRouter(include_in_schema=False)

_CHANGE: Shape[kbstore.Change] = Shape(answers.Change)


@router.get(
    "/changes/stream",
    tags=["questions"],
    response_class=StreamingResponse,
    responses={200: {"description": "Events of the type `change`.", "content": {"text/event-stream": {}}}},
)
async def changes_stream(
    store: TheStore,
    kb: Kb,
    pattern: Annotated[
        str | None, Query(description="Only changes of what matches; ? matches any object.", max_length=LONGEST)
    ] = None,
    after: Annotated[
        int | None, Query(description="The last transaction that is known; none: the latest.", ge=0, le=MOST_NUMBER)
    ] = None,
    last_event: LastEvent = None,
) -> StreamingResponse:
    """The changes as they happen, also by the clock alone, as server-sent events.

    The id of an event is the number of its transaction: a client that comes back with it as `Last-Event-ID` goes on
    after it.
    """
    known = int(last_event) if last_event and last_event.isdecimal() else after
    # awaited here, so that a wrong pattern is refused before the answer begins
    watch = await kb.watch(pattern, known, poll=POLL)
    return _stream(_changes(store, watch))


async def _changes(store: Store, watch: aio.Watch[kbstore.Change]) -> AsyncIterator[bytes]:
    async with store.following(watch):
        while True:
            try:
                change = await asyncio.wait_for(anext(watch), 15 * HEARTBEAT)
            except TimeoutError:
                yield b": still here\n\n"
            except StopAsyncIteration:
                return
            else:
                yield _event("change", _CHANGE.json(change).decode(), change.number)


@pages.get("/")
async def timeline(
    store: TheStore,
    kb: Annotated[str | None, Query(max_length=1000)] = None,
    pattern: Patterns = None,
    since: Since = None,
) -> HTMLResponse:
    """Show the timeline of a knowledge base; if there are several and none is named, a list of them."""
    names = await store.names() if kb is None else [kb]
    if len(names) != 1:
        return HTMLResponse(_index(names))

    def draw(plain: kbstore.KnowledgeBase) -> str:
        data = _data(plain, pattern, since)
        asked: list[tuple[str, str | int]] = [("kb", plain.name), ("known", data["latest"])]
        asked += [("pattern", each) for each in pattern or ()]
        if data["base"]:
            # the page keeps its beginning, also when the latest transactions are later ones
            asked.append(("since", data["origin"]))
        return page({**data, "stream": f"timeline/stream?{urlencode(asked)}"})

    return HTMLResponse(await store.read(await store.get(names[0]), draw))


@pages.get("/timeline/stream")
async def timeline_stream(
    store: TheStore,
    kb: Kb,
    known: Annotated[int, Query(ge=0, le=MOST_NUMBER)],
    pattern: Patterns = None,
    since: Since = None,
    last_event: LastEvent = None,
) -> StreamingResponse:
    """Send the updates of a page as they happen; to a page that was disconnected, all of its data."""
    watch = await kb.watch(poll=POLL)
    return _stream(
        _patches(store, kb, watch, lambda plain: _data(plain, pattern, since), None if last_event else known)
    )


def _data(kb: kbstore.KnowledgeBase, patterns: list[str] | None, since: str | None) -> dict[str, Any]:
    begin = moment(since)
    first = None if begin is None else kbstore.time(begin, kb.now())
    return timeline_data(kb, patterns or (), since=first, most=MOST_SHOWN)


async def _patches(
    store: Store,
    kb: aio.KnowledgeBase,
    watch: aio.Watch[kbstore.Change],
    shown: Callable[[kbstore.KnowledgeBase], dict[str, Any]],
    known: int | None,
) -> AsyncIterator[bytes]:
    async with store.following(watch):
        data = await store.read(kb, shown)
        if data["latest"] != known:
            yield _event("data", as_json(data), data["latest"])
        else:
            yield _event("now", str(data["now"]))
        while True:
            try:
                change = await asyncio.wait_for(anext(watch), HEARTBEAT)
            except TimeoutError:
                yield _event("now", str(await kb.now() - int(data["origin"])))
                continue
            except StopAsyncIteration:
                return
            if change.number <= data["latest"] and change.time <= int(data["origin"]) + data["now"]:
                # the data were read after the change
                continue
            begin = monotonic()
            before, data = data, await store.read(kb, shown)
            if before["origin"] != data["origin"]:
                yield _event("data", as_json(data), data["latest"])
            else:
                yield _event("patch", as_json(difference(before, data)), data["latest"])
            # a large history takes long to read, and is read less often
            await asyncio.sleep(min(5.0, 2 * (monotonic() - begin)))


def difference(before: dict[str, Any], after: dict[str, Any]) -> dict[str, Any]:
    """Return what differs: plain values as they are, and for each list its length and the entries that changed.

    >>> difference({"now": 1, "rows": ["a", "b"]}, {"now": 2, "rows": ["a", "c", "d"]})
    {'now': 2, 'rows': [3, [[1, 'c'], [2, 'd']]]}
    """
    found: dict[str, Any] = {}
    for name, new in after.items():
        old = before.get(name)
        if not isinstance(new, list):
            found[name] = new
        elif new != old:
            known = old or []
            found[name] = [len(new), [[i, each] for i, each in enumerate(new) if i >= len(known) or known[i] != each]]
    return found


def _stream(events: AsyncIterator[bytes]) -> StreamingResponse:
    return StreamingResponse(events, media_type="text/event-stream", headers={"X-Accel-Buffering": "no"})


def _event(kind: str, data: str, number: int | None = None) -> bytes:
    return (f"id: {number}\n" if number is not None else "").encode() + f"event: {kind}\ndata: {data}\n\n".encode()


def _index(names: list[str]) -> str:
    links = "".join(f'<li><a href="{html.escape(page_of(name))}">{html.escape(name)}</a></li>' for name in names)
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>kbstore</title><link rel="icon" href="data:,">'
        "<style>:root{color-scheme:light dark}body{font:15px/1.6 system-ui,sans-serif;margin:3em}</style>"
        f"<h1>Knowledge bases</h1><ul>{links or '<li>none yet</li>'}</ul></html>"
    )
