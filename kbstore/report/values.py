"""What kbstore answers, as values for JSON.

Each time comes twice: as ISO 8601 text (exact, to the nanosecond), and as an integer of nanoseconds under a name that
ends in ``_ns``. Each piece of knowledge comes as ``pddl`` text and as ``item``, a message in the shape of ROS's.
"""

from collections.abc import Iterable
from functools import singledispatch
from typing import Any

from kbstore.clock import isoformat
from kbstore.evaluation.intervals import Intervals
from kbstore.messages import Condition, Expression, Fact, Function, Inequality, Instance
from kbstore.model.results import (
    Applicability,
    Assertion,
    Change,
    Diff,
    Explanation,
    FailingCondition,
    Run,
    Transaction,
)
from kbstore.reading.state import State

Value = dict[str, Any]


@singledispatch
def plain(answer: object) -> Any:
    """An answer as dicts, lists, texts and numbers."""
    return answer


def times(**named: int | None) -> Value:
    """Times under their names, as text and in nanoseconds; None where there is none."""
    found: Value = {}
    for name, t in named.items():
        found[name] = None if t is None else isoformat(t)
        found[f"{name.removesuffix('_time')}_ns"] = t
    return found


def at(state: State) -> Value:
    """The time of a state, and of the belief if it is one."""
    return times(at=state.at, as_of=state.as_of)


def each(answers: Iterable[object]) -> list[Any]:
    """Several answers."""
    return [plain(answer) for answer in answers]


@plain.register
def _knowledge(item: Instance | Fact | Function | Expression | Inequality | Condition) -> Value:
    return {"pddl": str(item), "item": item.model_dump(mode="json")}


@plain.register
def _transaction(tx: Transaction) -> Value:
    return {"number": tx.number, **times(time=tx.time), "client": tx.client, "note": tx.note, "changes": tx.changes}


@plain.register
def _assertion(found: Assertion) -> Value:
    return {
        **plain(found.item),
        **times(initial_time=found.initial_time, end_time=found.end_time),
        "recorded": plain(found.recorded),
        "ended": plain(found.ended),
        "cancelled": plain(found.cancelled),
        "is_goal": found.is_goal,
    }


@plain.register
def _change(change: Change) -> Value:
    return {
        "number": change.number,
        **times(time=change.time),
        "by_clock": change.time != change.transaction.time,
        "transaction": plain(change.transaction),
        "asserted": each(change.asserted),
        "ended": each(change.ended),
        "cancelled": each(change.cancelled),
    }


@plain.register
def _diff(diff: Diff) -> Value:
    return {
        "became_true": each(diff.became_true),
        "became_false": each(diff.became_false),
        "withdrawn": each(diff.withdrawn),
        "numbers": [
            {"function": function.atom, "before": before, "after": after} for function, before, after in diff.numbers
        ],
        "goals_added": each(diff.goals_added),
        "goals_removed": each(diff.goals_removed),
        "metric": None if diff.metric is None else each(diff.metric),
    }


@plain.register
def _run(run: Run) -> Value:
    return {
        "operator": run.operator,
        "arguments": list(run.arguments),
        **times(started=run.started),
        "duration_ns": run.duration,
        **times(expected_end=run.expected_end),
    }


@plain.register
def _failing(failing: FailingCondition) -> Value:
    return {"condition": failing.condition, "truth": str(failing.truth), **times(since=failing.since)}


@plain.register
def _applicability(answer: Applicability) -> Value:
    return {"applicable": bool(answer), "failing": each(answer.failing)}


@plain.register
def _explanation(explanation: Explanation) -> Value:
    return {
        "subject": explanation.subject,
        "truth": str(explanation.truth),
        "reason": explanation.reason,
        **times(since=explanation.since),
        "transaction": plain(explanation.transaction),
        "parts": each(explanation.parts),
    }


@plain.register
def _intervals(found: Intervals) -> list[Value]:
    return [times(start=start, end=end) for start, end in found]


@plain.register
def _state(state: State) -> Value:
    return {
        "knowledge_base": state.name,
        **at(state),
        "domain": None if state.domain is None else state.domain.name,
        "use_unknowns": state.use_unknowns,
        "instances": each(state.instances),
        "facts": each(state.facts),
        "functions": each(state.functions),
        "inequalities": each(state.inequalities),
        "metric": plain(state.metric),
        "goals": each(state.goals),
        "timed_knowledge": each(state.timed_knowledge),
        "running": each(state.running),
        "constraints": list(state.constraints),
    }
