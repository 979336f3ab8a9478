"""Worlds and histories made of dictionaries, for tests: the plainest `Interpretation` and `Course`.

Things are written as words: ``"robot_at kenny wp0"`` is the atom ``(robot_at kenny wp0)``. They are lower case,
as all keys are. Nothing is checked.

    World(domain, objects={"kenny": "robot"}, facts={"docked kenny": True}, numbers={"battery kenny": 80.0})
    History(
        (0, 100),
        domain,
        objects={"kenny": "robot", "wp1": [(10, 50, "waypoint")]},
        facts={"docked kenny": [(0, 20, True), (30, 40, False)]},
        numbers={"battery kenny": [(0, 100, Number(80.0, rate=-1.0, since=0))]},
    )

Constants come from the domain. Without a domain every object is of the type that it was given, and ``object`` is
above all types.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

from kbstore.evaluation.interpretation import Arguments, Number, Span
from kbstore.model.domain import Domain, Signature
from kbstore.model.formulas import Parameter


def words(text: str) -> tuple[str, Arguments]:
    """The name and the arguments of ``"robot_at kenny wp0"``."""
    name, *arguments = text.split()
    return name, tuple(arguments)


def signature(text: str) -> Signature:
    """A signature from ``"robot_at r:robot wp:waypoint"``; several types are ``"r:robot|truck"``."""
    name, *parameters = text.split()
    return Signature(
        name, tuple(Parameter(p.split(":")[0], tuple([*p.split(":"), "object"][1].split("|"))) for p in parameters)
    )


def signatures(*texts: str) -> dict[str, Signature]:
    """Signatures by name, as `Domain` takes them."""
    return {s.name.lower(): s for s in map(signature, texts)}


class World:
    """The state at one time, in dictionaries (an `Interpretation`)."""

    def __init__(
        self,
        domain: Domain | None = None,
        *,
        time: int = 0,
        use_unknowns: bool = False,
        objects: Mapping[str, str] | None = None,
        facts: Mapping[str, bool] | None = None,
        numbers: Mapping[str, Number | float] | None = None,
    ) -> None:
        self.time = time
        self.domain = domain
        self.use_unknowns = use_unknowns
        self.types_of = {**(domain.constant_types if domain else {}), **(objects or {})}
        self.signs = {words(text): sign for text, sign in (facts or {}).items()}
        self.values = {
            words(text): number if isinstance(number, Number) else Number(number, since=time)
            for text, number in (numbers or {}).items()
        }

    def sign(self, name: str, arguments: Arguments) -> bool | None:
        return self.signs.get((name, arguments))

    def facts(self, name: str) -> Iterator[tuple[Arguments, bool]]:
        return ((key[1], sign) for key, sign in self.signs.items() if key[0] == name)

    def number(self, name: str, arguments: Arguments) -> Number | None:
        return self.values.get((name, arguments))

    def objects(self, types: Iterable[str]) -> Collection[str]:
        types = list(types)
        return [name for name, type_name in self.types_of.items() if is_of(self.domain, type_name, types)]

    def type_of(self, name: str) -> str | None:
        return self.types_of.get(name)


class History:
    """The states over a span, in dictionaries of pieces (a `Course`)."""

    def __init__(
        self,
        span: Span,
        domain: Domain | None = None,
        *,
        use_unknowns: bool = False,
        objects: Mapping[str, str | Sequence[tuple[int, int, str]]] | None = None,
        facts: Mapping[str, Sequence[tuple[int, int, bool]]] | None = None,
        numbers: Mapping[str, Sequence[tuple[int, int, Number]]] | None = None,
    ) -> None:
        self.span = span
        self.domain = domain
        self.use_unknowns = use_unknowns
        given = {**(domain.constant_types if domain else {}), **(objects or {})}
        self.pieces_of_objects = {
            name: [(*span, pieces)] if isinstance(pieces, str) else list(pieces) for name, pieces in given.items()
        }
        self.pieces_of_facts = {words(text): list(pieces) for text, pieces in (facts or {}).items()}
        self.pieces_of_numbers = {words(text): list(pieces) for text, pieces in (numbers or {}).items()}

    def signs(self, name: str, arguments: Arguments) -> Sequence[tuple[int, int, bool]]:
        return self.pieces_of_facts.get((name, arguments), [])

    def all_signs(self, name: str) -> Mapping[Arguments, Sequence[tuple[int, int, bool]]]:
        return {key[1]: pieces for key, pieces in self.pieces_of_facts.items() if key[0] == name}

    def numbers(self, name: str, arguments: Arguments) -> Sequence[tuple[int, int, Number]]:
        return self.pieces_of_numbers.get((name, arguments), [])

    def lifespans(self, types: Iterable[str]) -> Mapping[str, Sequence[Span]]:
        types = list(types)
        found = {
            name: [(start, end) for start, end, type_name in pieces if is_of(self.domain, type_name, types)]
            for name, pieces in self.pieces_of_objects.items()
        }
        return {name: spans for name, spans in found.items() if spans}

    def lifespan(self, name: str) -> Sequence[tuple[int, int, str]]:
        return self.pieces_of_objects.get(name, [])

    def at(self, t: int) -> World:
        """The world at one time of the span, found by looking at every piece."""
        world = World(self.domain, time=t, use_unknowns=self.use_unknowns)
        world.types_of = {k: p[2] for k, pieces in self.pieces_of_objects.items() for p in pieces if p[0] <= t < p[1]}
        world.signs = {k: p[2] for k, pieces in self.pieces_of_facts.items() for p in pieces if p[0] <= t < p[1]}
        world.values = {k: p[2] for k, pieces in self.pieces_of_numbers.items() for p in pieces if p[0] <= t < p[1]}
        return world


def is_of(domain: Domain | None, type_name: str, types: list[str]) -> bool:
    """Whether a type is one of the types or below one."""
    if domain is not None:
        return domain.is_subtype(type_name, types)
    return "object" in types or type_name in types
