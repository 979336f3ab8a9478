"""Shell completion of names that the store knows; after an error there are no suggestions."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import typer

import kbstore
from kbstore.errors import KbStoreError
from kbstore.names import bracketed

if TYPE_CHECKING:
    from kbstore.knowledge_base import KnowledgeBase
    from kbstore.reading.state import State


def names(ctx: typer.Context) -> list[str]:
    """The knowledge bases of the store."""
    try:
        return kbstore.knowledge_bases(_url(ctx))
    except (KbStoreError, OSError):
        return []


def operators(ctx: typer.Context) -> list[str]:
    """The operators of the domain."""
    with _state(ctx) as state:
        return [] if state is None or state.domain is None else [*state.domain.operators]


def arguments(ctx: typer.Context) -> list[str]:
    """The objects that fit the next parameter of the operator."""
    with _state(ctx) as state:
        if state is None or state.domain is None:
            return []
        action = state.domain.actions.get((ctx.params.get("operator") or "").lower())
        place = len(ctx.params.get("arguments") or ())
        if action is None or place >= len(action.parameters):
            return []
        return sorted({name for type_name in action.parameters[place].types for name in state.objects(type_name)})


def objects(ctx: typer.Context) -> list[str]:
    """The objects that exist, constants included."""
    with _state(ctx) as state:
        return [] if state is None else sorted(state.objects())


def patterns(ctx: typer.Context) -> list[str]:
    """The predicates and functions of the domain, with a ``?`` for each argument."""
    with _state(ctx) as state:
        if state is None or state.domain is None:
            return []
        signatures = (*state.domain.predicate_signatures.values(), *state.domain.function_signatures.values())
        return [bracketed(signature.name, *("?" for _ in signature.parameters)) for signature in signatures]


@contextmanager
def _state(ctx: typer.Context) -> Iterator["State | None"]:
    try:
        with _open(ctx) as kb:
            state = None if kb is None else kb.state()
    except (KbStoreError, OSError):
        state = None
    yield state


@contextmanager
def _open(ctx: typer.Context) -> Iterator["KnowledgeBase | None"]:
    url = _url(ctx)
    name = ctx.params.get("kb") or ctx.find_root().params.get("kb")
    known = kbstore.knowledge_bases(url)
    name = known[0] if name is None and len(known) == 1 else name
    if name not in known:
        yield None
        return
    with kbstore.open(url, name, read_only=True) as kb:
        yield kb


def _url(ctx: typer.Context) -> str:
    return ctx.params.get("url") or ctx.find_root().params.get("url") or ""
