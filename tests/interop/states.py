"""States made of PDDL text, without a database, and the domain that most tests use."""

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

from kbstore.clock import SECOND
from kbstore.messages import Condition, Fact, Function, Instance
from kbstore.pddl.domain_reader import read_domain
from kbstore.pddl.parse import parse_item

HEAD = """
(define (domain Robots)
  (:requirements :adl :typing :numeric-fluents :durative-actions :timed-initial-literals)
  (:types Robot truck - mover mover place - object)
  (:constants Depot - place)
  (:predicates (At ?m - mover ?p - place) (open) (visited ?p - place) (path ?a ?b - place))
  (:functions (battery ?m - mover) (dist ?a ?b - place) (speed) (total-cost))
"""


def state(
    actions: str = "",
    *,
    head: str = HEAD,
    objects: str = "kenny - robot wp0 - place wp1 - place",
    init: Sequence[str] = (),
    goals: Sequence[str | Condition] = (),
    metric: str | None = None,
    timed: Mapping[float, str] | None = None,
    ends: Sequence[tuple[float, str, Any]] = (),
    constraints: Sequence[str] = (),
    at: float = 0,
) -> Any:
    """A state, as far as a problem needs it; times are in seconds, those of `timed` from time 0 on."""
    domain = read_domain(f"{head} {actions})")
    items = [parse_item(text, domain) for text in init]
    words = objects.split()
    instances = [parse_item(" ".join(words[i : i + 3]), domain) for i in range(0, len(words), 3)]
    return SimpleNamespace(
        domain=domain,
        name="kenny",
        at=round(at * SECOND),
        instances=[item for item in instances if isinstance(item, Instance)],
        facts=[item for item in items if isinstance(item, Fact)],
        functions=[item for item in items if isinstance(item, Function)],
        goals=[parse_item(goal, domain) if isinstance(goal, str) else goal for goal in goals],
        metric=None if metric is None else parse_item(metric, domain),
        timed_knowledge=[
            parse_item(text, domain).changed(initial_time=round(t * SECOND)) for t, text in (timed or {}).items()
        ],
        end_effects=[(round(t * SECOND), parse_item(text, domain), run) for t, text, run in ends],
        constraints=list(constraints),
    )
