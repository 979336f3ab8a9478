"""The web application of one store: questions, changes, streams and the page, behind the guard."""

from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from importlib.metadata import version
from typing import Any

from fastapi import FastAPI
from fastapi.middleware.cors import CORSMiddleware
from starlette.middleware import Middleware

from kbstore.serve import live, problems, questions, updates
from kbstore.serve.guard import Guard, refuse_unsafe
from kbstore.serve.store import Store

LARGEST_BODY = 20_000_000
"""The most bytes of a request."""

DESCRIPTION = """\
What holds at any time in the knowledge bases of a robot, and what was believed of it. Knowledge is PDDL; `at` is the
time that is asked about, `as_of` the time, or the transaction, whose belief is asked for. Times in answers are ISO 8601
text in UTC, exact to the nanosecond. Errors are problems (RFC 9457) with a sentence that says what to do.
"""


def make_app(
    store: Store,
    *,
    host: str = "127.0.0.1",
    token: str | None = None,
    allow_writes: bool = False,
    allow_origins: Sequence[str] = (),
) -> FastAPI:
    """Return the application of a store, which it closes when it ends.

    Args:
        store: the knowledge bases.
        host: the address at which it is served.
        token: the token that requests have to give; it may be None on an address of this machine only.
        allow_writes: whether requests may change something; `store` has to allow it, too.
        allow_origins: the origins of other sites whose pages may ask.

    Raises:
        InvalidKnowledge: the address can be reached by others, and there is no token, or a short one.
    """
    refuse_unsafe(host, token)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        try:
            yield
        finally:
            await store.close()

    layers = [
        Middleware(Guard, host=host, token=token, allow_writes=allow_writes, allow_origins=allow_origins),
    ]
    if allow_origins:
        headers = ["Authorization", "Content-Type", "Last-Event-ID"]
        layers.insert(
            0,
            Middleware(
                CORSMiddleware, allow_origins=list(allow_origins), allow_methods=["GET", "POST"], allow_headers=headers
            ),
        )
    app = _Application(
        title="kbstore",
        version=version("kbstore"),
        description=DESCRIPTION,
        lifespan=lifespan,
        middleware=layers,
        # their pages ask other hosts for scripts
        docs_url=None,
        redoc_url=None,
        max_body_size=LARGEST_BODY,
    )
    app.state.store = store
    problems.install(app)
    for router in (questions.router, live.router, *([updates.router] if allow_writes else [])):
        app.include_router(router, prefix="/api", responses=problems.RESPONSES)
    app.include_router(live.pages)
    return app


class _Application(FastAPI):
    """An application whose OpenAPI description has the schema of problems."""

    def openapi(self) -> dict[str, Any]:
        """Return the description of the interface."""
        found = super().openapi()
        found.setdefault("components", {}).setdefault("schemas", {})["Problem"] = problems.SCHEMA
        return found
