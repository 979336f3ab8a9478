"""The changes: a POST for each, which is one transaction, if the service may write."""

from collections.abc import Callable
from typing import Annotated, Any

from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict, Field

import kbstore
from kbstore.serve import answers
from kbstore.serve.parameters import LONGEST, Kb, moment
from kbstore.serve.problems import Refused

router = APIRouter(tags=["changes"])

MOST_ITEMS = 100_000

Pddl = Annotated[str, Field(max_length=LONGEST)]
Items = Annotated[
    list[Pddl], Field(min_length=1, max_length=MOST_ITEMS, description="Knowledge in PDDL.", examples=[["(open hall)"]])
]
Time = Annotated[str | None, Field(max_length=100)]


class _Body(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    client: Annotated[str, Field(max_length=1000, description="Who writes.")] = ""
    note: Annotated[str, Field(max_length=LONGEST, description="Why.")] = ""

    @property
    def by(self) -> dict[str, str]:
        """Who writes, and why."""
        return {"client": self.client, "note": self.note}


class Update(_Body):
    """Knowledge to add or remove, and its valid time."""

    items: Items
    initial_time: Time = None
    """The time from which on it holds; a time after now makes it scheduled."""
    since: Time = None
    """The past time since which it has held, for late knowledge."""
    until: Time = None


class Replacement(_Body):
    """All knowledge that is to hold."""

    items: Annotated[list[Pddl], Field(max_length=MOST_ITEMS)]


class Metric(_Body):
    """A metric: ``minimize (total-time)``."""

    metric: Pddl


class Action(_Body):
    """An action, with the objects for its parameters."""

    operator: Annotated[str, Field(max_length=1000)]
    arguments: Annotated[list[Annotated[str, Field(max_length=1000)]], Field(max_length=100)] = []


class Start(Action):
    """An action to be started."""

    seconds: Annotated[
        float | None, Field(ge=0, le=10**9, description="Its duration; none where the domain fixes it.")
    ] = None
    force: bool = False


class RunNumber(_Body):
    """A run, by its number."""

    run: Annotated[int, Field(ge=0, le=2**62)]


class Ended(answers.Transaction):
    """The transaction that ended an action, and the at-end conditions that failed."""

    failing: list[answers.Text]
    broken: list[answers.Broken]


def _updating(path: str, method: Callable[..., Any], summary: str) -> None:
    @router.post(path, response_model=answers.Transaction, summary=summary, operation_id=path[1:].replace("-", "_"))
    async def update(kb: Kb, body: Update) -> Any:
        times = {name: moment(getattr(body, name)) for name in ("initial_time", "since", "until")}
        return await kb.write(lambda plain: method(plain, *body.items, **times, **body.by))


for _path, _method, _summary in (
    ("/add", kbstore.KnowledgeBase.add, "Add knowledge to the state"),
    ("/remove", kbstore.KnowledgeBase.remove, "Remove what matches from the state"),
    ("/add-goal", kbstore.KnowledgeBase.add_goal, "Add to the goal"),
    ("/remove-goal", kbstore.KnowledgeBase.remove_goal, "Remove from the goal"),
):
    _updating(_path, _method, _summary)


@router.post("/set-metric", response_model=answers.Transaction)
async def set_metric(kb: Kb, body: Metric) -> Any:
    """Set the metric; it replaces any other."""
    return await kb.add_metric(body.metric, **body.by)


@router.post("/replace", response_model=answers.Transaction)
async def replace(kb: Kb, body: Replacement) -> Any:
    """Make the state what the items assert, and record the difference alone."""
    return await kb.replace(*body.items, **body.by)


@router.post("/apply", response_model=answers.Transaction)
async def apply(kb: Kb, body: Action) -> Any:
    """Apply an instantaneous action."""
    return await kb.apply(body.operator, *body.arguments, **body.by)


@router.post("/start", response_model=answers.Run)
async def start(kb: Kb, body: Start) -> Any:
    """Start a durative action."""
    duration = None if body.seconds is None else kbstore.seconds(body.seconds)
    return await kb.start(body.operator, *body.arguments, duration=duration, force=body.force, **body.by)


@router.post("/end", response_model=Ended)
async def end(kb: Kb, body: RunNumber) -> Any:
    """End a durative action that runs."""
    return await kb.write(lambda plain: plain.end(_running(plain, body.run), **body.by))


@router.post("/abort", response_model=answers.Transaction)
async def abort(kb: Kb, body: RunNumber) -> Any:
    """Abort a durative action that runs."""
    return await kb.write(lambda plain: plain.abort(_running(plain, body.run), **body.by))


def _running(kb: kbstore.KnowledgeBase, number: int) -> kbstore.Run:
    found = next((run for run in kb.state().running if run.number == number), None)
    if found is None:
        raise Refused(404, f"no action with the number {number} runs; /api/runs lists them")
    return found
