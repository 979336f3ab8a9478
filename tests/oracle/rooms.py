"""The small world of the reference's scenarios: a place, a robot, a lamp, two numbers."""

from tests.oracle import Fact, Object, RefDomain, Update

DOMAIN = RefDomain(
    "rooms",
    types={"place": "object", "room": "place", "robot": "object"},
    constants={"home": "place"},
    predicates={"lit": (), "open": (("place",),), "near": (("robot",), ("place",))},
    functions={"load": (("robot",),), "cost": ()},
)
A, R = Object("a", "place"), Object("r", "robot")
OPEN, SHUT, NEAR = Fact("open", ("a",)), Fact("open", ("a",), False), Fact("near", ("r", "a"))
LIT, DARK = Fact("lit"), Fact("lit", (), False)
S = 1_000_000_000


def add(item, since=None, until=None, at=0):
    return Update("add", item, at, since, until)


def remove(item, since=None, until=None, at=0):
    return Update("remove", item, at, since, until)
