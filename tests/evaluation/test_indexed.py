"""Conditions in a world with an index of facts by object: the answers are the same, and no relation is read whole."""

from collections.abc import Collection, Iterable, Iterator

import pytest
from hypothesis import given, settings

from kbstore.evaluation import joins
from kbstore.evaluation.conditions import truth
from kbstore.evaluation.interpretation import Arguments
from kbstore.messages.enums import Truth
from kbstore.model.formulas import And, Atom, Formula
from tests.evaluation import brute_force
from tests.evaluation.interpretations import World
from tests.evaluation.strategies import DOMAIN, conditions, exists, worlds


class Indexed(World):
    """A world with an index, which counts the relations that are read whole."""

    whole = 0

    def facts(self, name: str) -> Iterator[tuple[Arguments, bool]]:
        self.whole += 1
        return super().facts(name)

    def objects(self, types: Iterable[str]) -> Collection[str]:
        self.whole += 1
        return super().objects(types)

    def matching(self, name: str, wanted: tuple[str | None, ...]) -> Iterable[tuple[Arguments, bool]]:
        assert any(wanted)
        for row, sign in super().facts(name):
            if len(row) == len(wanted) and all(w in (None, value) for w, value in zip(wanted, row, strict=True)):
                yield row, sign


def indexed(world: World) -> Indexed:
    found = Indexed(world.domain, time=world.time, use_unknowns=world.use_unknowns)
    found.types_of, found.signs, found.values = world.types_of, world.signs, world.values
    return found


@pytest.mark.parametrize("read_all", [0, 1, 16])
@settings(max_examples=100, deadline=None)
@given(conditions(), worlds())
def test_random_conditions_are_the_same(read_all: int, condition: Formula, world: World) -> None:
    """V2 to V5, V7 to V9: at any limit of single look-ups."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(joins, "_READ_ALL", read_all)
        assert truth(condition, indexed(world)) is brute_force.truth(condition, world)


@settings(max_examples=60, deadline=None)
@given(conditions(), worlds())
def test_random_conditions_without_a_domain_are_the_same(condition: Formula, world: World) -> None:
    """D2: also without a domain."""
    world.domain = None
    assert truth(condition, indexed(world)) is brute_force.truth(condition, world)


def test_atoms_with_objects_are_looked_up() -> None:
    """A pattern, an existence and a join with an object in them read neither a whole predicate nor all objects."""
    objects = {"r1": "robot", **{f"p{i}": "place" for i in range(50)}}
    facts = {"at r1 p7": True, "free p7": True, **{f"free p{i}": True for i in range(20, 50)}}
    world = Indexed(DOMAIN, objects=objects, facts=facts)
    here = Atom("at", ("r1", "?p"))
    for condition, expected in (
        (Atom("at", ("r1", "?")), Truth.TRUE),
        (exists("p:place", here), Truth.TRUE),
        (exists("p:place", And((here, Atom("free", ("?p",))))), Truth.TRUE),
        (exists("p:dock", here), Truth.FALSE),
        (Atom("at", ("r2", "?")), Truth.FALSE),
    ):
        assert truth(condition, world) is expected
    assert world.whole == 0
