"""The questions: a GET for each, answered by the method of that name."""

from collections.abc import Callable, Coroutine
from itertools import islice
from typing import Annotated, Any, TypeVar

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import PlainTextResponse
from fastapi.routing import APIRoute
from starlette.datastructures import QueryParams

import kbstore
from kbstore import Truth, aio
from kbstore.serve import answers
from kbstore.serve.answers import Shape
from kbstore.serve.parameters import (
    LONGEST,
    After,
    AsOf_,
    At,
    Condition,
    Kb,
    Pattern,
    Since,
    TheStore,
    Until,
    belief,
    moment,
)
from kbstore.serve.problems import Refused
from kbstore.serve.store import Store

Answer = TypeVar("Answer")

MOST_CHANGES = 1000

router = APIRouter(tags=["questions"])

_SITUATION: Shape[kbstore.State] = Shape(answers.Situation)
_HISTORY: Shape[list[kbstore.Assertion]] = Shape(list[answers.Assertion])
_INTERVALS: Shape[list[tuple[int, int]]] = Shape(list[answers.Interval])
_RUNS: Shape[list[kbstore.Run]] = Shape(list[answers.Run])
_CHANGES: Shape[list[kbstore.Change]] = Shape(list[answers.Change])
_DIFFERENCE: Shape[kbstore.Diff] = Shape(answers.Difference)
_EXPLANATION: Shape[kbstore.Explanation] = Shape(answers.Explanation)
_BINDINGS: Shape[list[dict[str, str]]] = Shape(list[dict[str, str]])
_HOLDING: Shape[dict[str, Any]] = Shape(answers.Holding)
_VALUE: Shape[dict[str, Any]] = Shape(answers.Value)


async def answered(
    store: Store, kb: aio.KnowledgeBase, shape: Shape[Answer], ask: Callable[[kbstore.KnowledgeBase], Answer]
) -> Response:
    """Ask in a thread, and write the answer as JSON there, too, as a large one would keep everybody else waiting."""
    return _response(store, await store.read(kb, lambda plain: shape.json(ask(plain))))


def _response(store: Store, body: bytes, media_type: str = "application/json") -> Response:
    if len(body) > store.most:
        raise Refused(
            422,
            f"the answer has {len(body):,} bytes, and at most {store.most:,} are sent: ask for less, such as a span",
        )
    return Response(body, media_type=media_type)


@router.get("/knowledge-bases", response_model=list[answers.Served])
async def knowledge_bases(store: TheStore) -> list[dict[str, str]]:
    """The knowledge bases of the store."""
    return [{"name": name, "page": page_of(name)} for name in await store.names()]


def page_of(name: str) -> str:
    """The address of a knowledge base's timeline."""
    return f"/?{QueryParams({'kb': name})}"


@router.get("/state", response_model=answers.Situation)
async def state(store: TheStore, kb: Kb, at: At = None, as_of: AsOf_ = None) -> Response:
    """Everything that holds at a time; with `as_of`, as it was believed then."""
    return await answered(store, kb, _SITUATION, lambda plain: plain.state(moment(at), belief(as_of, plain)))


class _QuickRoute(APIRoute):
    """Answers at once whether a fact holds now, where that needs no thread.

    FastAPI takes three times as long to read the parameters as such an answer takes. It reads those of all others.
    """

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return what handles a request."""
        others = super().get_route_handler()

        async def handle(request: Request) -> Response:
            asked = request.query_params
            condition = asked.get("condition")
            if condition is not None and asked.keys() <= {"condition", "kb"}:
                kb = request.app.state.store.opened(asked.get("kb"))
                if kb is not None and kb.is_quick(condition):
                    return _holding(condition, await kb.truth(condition))
            return await others(request)

        return handle


_quick = APIRouter(route_class=_QuickRoute)


@_quick.get("/holds", response_model=answers.Holding)
async def holds(store: TheStore, kb: Kb, condition: Condition, at: At = None, as_of: AsOf_ = None) -> Response:
    """Whether a fact or condition is true."""
    return _holding(
        condition, await store.read(kb, lambda plain: plain.truth(condition, moment(at), belief(as_of, plain)))
    )


def _holding(condition: str, truth: Truth) -> Response:
    body = _HOLDING.json({"condition": condition, "holds": truth is Truth.TRUE, "truth": truth})
    return Response(body, media_type="application/json")


router.include_router(_quick)


@router.get("/value", response_model=answers.Value)
async def value(
    store: TheStore,
    kb: Kb,
    expression: Annotated[
        str,
        Query(
            description="A numeric function or expression in PDDL.", max_length=LONGEST, examples=["(battery kenny)"]
        ),
    ],
    at: At = None,
    as_of: AsOf_ = None,
) -> Response:
    """The value of a numeric function or expression."""
    return await answered(
        store,
        kb,
        _VALUE,
        lambda plain: {"expression": expression, "value": plain.value(expression, moment(at), belief(as_of, plain))},
    )


@router.get("/find", response_model=list[dict[str, str]])
async def find(store: TheStore, kb: Kb, condition: Condition, at: At = None, as_of: AsOf_ = None) -> Response:
    """The objects for the free variables of a condition for which it is true."""
    return await answered(store, kb, _BINDINGS, lambda plain: plain.find(condition, moment(at), belief(as_of, plain)))


@router.get("/explain", response_model=answers.Explanation)
async def explain(store: TheStore, kb: Kb, condition: Condition, at: At = None, as_of: AsOf_ = None) -> Response:
    """Why a fact or condition is true, false or unknown, and the transaction that made it so."""
    return await answered(
        store, kb, _EXPLANATION, lambda plain: plain.explain(condition, moment(at), belief(as_of, plain))
    )


@router.get("/history", response_model=list[answers.Assertion])
async def history(
    store: TheStore, kb: Kb, pattern: Pattern, since: Since = None, until: Until = None, as_of: AsOf_ = None
) -> Response:
    """The assertions that match a pattern, in order of time."""

    def ask(plain: kbstore.KnowledgeBase) -> list[kbstore.Assertion]:
        first = plain.history_from if since is None else moment(since)
        return plain.history(pattern, first, moment(until), belief(as_of, plain))

    return await answered(store, kb, _HISTORY, ask)


@router.get("/when", response_model=list[answers.Interval])
async def when(
    store: TheStore, kb: Kb, condition: Condition, since: Since = None, until: Until = None, as_of: AsOf_ = None
) -> Response:
    """The intervals in which a condition is true; without `until` they end now."""

    def ask(plain: kbstore.KnowledgeBase) -> list[tuple[int, int]]:
        first = plain.history_from if since is None else moment(since)
        last = "now" if until is None else moment(until)
        return plain.when(condition, first, last, belief(as_of, plain))

    return await answered(store, kb, _INTERVALS, ask)


@router.get("/diff", response_model=answers.Difference)
async def diff(
    store: TheStore,
    kb: Kb,
    before: Annotated[str, Query(description="The earlier time.", max_length=100, examples=["-5m"])],
    after: Annotated[str, Query(description="The later time.", max_length=100)] = "now",
    as_of: AsOf_ = None,
) -> Response:
    """What became true or false, was withdrawn, or changed between two times."""

    def ask(plain: kbstore.KnowledgeBase) -> kbstore.Diff:
        return plain.diff(moment(before), moment(after), belief(as_of, plain))

    return await answered(store, kb, _DIFFERENCE, ask)


@router.get("/runs", response_model=list[answers.Run])
async def runs(
    store: TheStore,
    kb: Kb,
    pattern: Annotated[
        str | None, Query(description="(goto kenny ? ?), or the name of an operator.", max_length=LONGEST)
    ] = None,
    since: Since = None,
    until: Until = None,
    as_of: AsOf_ = None,
) -> Response:
    """The durative actions that ran within a span, in the order of their starts."""
    return await answered(
        store, kb, _RUNS, lambda plain: plain.runs(pattern, moment(since), moment(until), belief(as_of, plain))
    )


@router.get("/changes", response_model=list[answers.Change])
async def changes(
    store: TheStore,
    kb: Kb,
    after: After = 0,
    limit: Annotated[int, Query(description="How many at most.", ge=1, le=MOST_CHANGES)] = 100,
) -> Response:
    """The transactions after a number, in the order of commit, with all that they did."""
    return await answered(store, kb, _CHANGES, lambda plain: list(islice(plain.changes(after), limit)))


@router.get("/problem.pddl", response_class=PlainTextResponse, responses={200: {"description": "The problem in PDDL."}})
async def problem_pddl(store: TheStore, kb: Kb, at: At = None, as_of: AsOf_ = None) -> Response:
    """The planning problem as of any moment, in PDDL."""
    text = await store.read(kb, lambda plain: plain.to_pddl(moment(at), belief(as_of, plain)))
    return _response(store, text.encode(), "text/plain; charset=utf-8")
