"""The data of a `State`, and the parts that Pydantic writes of it."""

from dataclasses import dataclass
from typing import Any

from kbstore.evaluation.snapshot import Snapshot
from kbstore.messages import Expression, Fact, Function, Goal, Inequality, Instance, KnowledgeItem
from kbstore.model.results import Run
from kbstore.model.timelines import StateRow
from kbstore.planning.rates import RunningAction

PARTS: dict[str, Any] = {
    "name": str,
    "at": int,
    "as_of": int | None,
    "use_unknowns": bool,
    "instances": list[Instance],
    "facts": list[Fact],
    "functions": list[Function],
    "inequalities": list[Inequality],
    "metric": Expression | None,
    "goals": list[Goal],
    "timed_knowledge": list[KnowledgeItem],
    "running": list[Run],
    "constraints": list[str],
}
"""The parts of a `State` that a web framework answers with, and their types."""


@dataclass(frozen=True, slots=True)
class StateData:
    """The assertions that hold at a time, the scheduled ones, and the running actions."""

    snapshot: Snapshot
    pending: list[StateRow]
    running: list[RunningAction]

    @property
    def size(self) -> int:
        """The size as caches count it: the number of assertions, and one for the state itself."""
        return 1 + sum(map(len, self.snapshot.parts.values())) + len(self.pending)


def state_schema(kind: type, handler: Any) -> Any:
    """Return how Pydantic takes and writes a `State`, which is the class `kind`: a state is written as its parts."""
    from pydantic_core import core_schema

    parts = core_schema.typed_dict_schema(
        {name: core_schema.typed_dict_field(handler.generate_schema(type_)) for name, type_ in PARTS.items()}
    )
    written = core_schema.plain_serializer_function_ser_schema(dict, return_schema=parts)
    return core_schema.is_instance_schema(kind, serialization=written)
