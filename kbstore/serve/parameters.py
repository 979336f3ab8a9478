"""Parameters of requests: the knowledge base, times, beliefs, knowledge."""

import re
from typing import Annotated, overload

from fastapi import Depends, Query, Request

import kbstore
from kbstore import aio
from kbstore.model.results import AsOf
from kbstore.report.belief import named_transaction
from kbstore.serve.store import Store

LONGEST = 20_000
"""The most characters of a condition."""

MOST_NUMBER = 2**62

TIMES = "ISO 8601 with an offset, now, relative to now (-5m), or nanoseconds."


async def store_of(request: Request) -> Store:
    """The store that the application serves."""
    found: Store = request.app.state.store
    return found


TheStore = Annotated[Store, Depends(store_of)]
Name = Annotated[
    str | None,
    Query(alias="kb", description="The knowledge base; not needed if the store has only one.", max_length=1000),
]


async def _knowledge_base(store: TheStore, name: Name = None) -> aio.KnowledgeBase:
    return await store.get(name)


Kb = Annotated[aio.KnowledgeBase, Depends(_knowledge_base)]
At = Annotated[str | None, Query(description=f"The time to ask about; now if none is given. {TIMES}", max_length=100)]
AsOf_ = Annotated[
    str | None,
    Query(description="Answer with what was believed at this time, or after transaction 12: tx12.", max_length=100),
]
Since = Annotated[str | None, Query(description=f"The beginning of the span. {TIMES}", max_length=100)]
Until = Annotated[str | None, Query(description="The end of the span.", max_length=100)]
Condition = Annotated[
    str, Query(description="A fact or a condition in PDDL.", max_length=LONGEST, examples=["(robot_at kenny ?)"])
]
Pattern = Annotated[
    str,
    Query(
        description="A fact, function or object in PDDL; ? matches any object.",
        max_length=LONGEST,
        examples=["(robot_at kenny ?)"],
    ),
]
After = Annotated[int, Query(description="Only what comes after this transaction.", ge=0, le=MOST_NUMBER)]


@overload
def moment(text: str) -> int | str: ...
@overload
def moment(text: None) -> None: ...
@overload
def moment(text: str | None) -> int | str | None: ...
def moment(text: str | None) -> int | str | None:
    """Return a time as kbstore takes it; None for None.

    A plus sign that is not escaped in an address arrives as a space.

    >>> moment(" 5m"), moment("2026-05-04T09:00:00 02:00"), moment("1500000000")
    ('+5m', '2026-05-04T09:00:00+02:00', 1500000000)
    """
    if text is None:
        return None
    meant = re.sub(r"(T\S*) (\d\d:?\d\d)$", r"\1+\2", re.sub(r"^ (?=\d)", "+", text))
    return int(meant) if re.fullmatch(r"[0-9]{1,25}", meant) else meant


def belief(text: str | None, kb: kbstore.KnowledgeBase) -> AsOf | None:
    """Return the time, or the transaction (``tx12``), whose belief is asked for."""
    return None if text is None else named_transaction(text, kb) or moment(text)
