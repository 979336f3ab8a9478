"""The one kind of cache that kbstore has, and all that is kept in it.

=====================  =============================  ========================  =====================================
what                   key                            bound                     dropped when
=====================  =============================  ========================  =====================================
timelines              number; role, kind and key     200,000                   never wrong: a timeline never changes,
                                                                                nor does the message of its latest row
domain versions        version number                 all                       never wrong: a version never changes
prepared questions     domain version and question    50,000                    never wrong: made anew for a version
past states            valid time                     50,000 assertions         late knowledge reaches their time
open rows              number of a timeline           50,000                    somebody else writes
answers about now      question; of one connection,   50,000                    somebody commits to it, or it is told
                       or while notified                                        of that; a part changes by the clock
parts of the present   which part; the same           50,000 assertions         the same
answers of a `State`   question                       1,000 of each state       never wrong: a state never changes
=====================  =============================  ========================  =====================================

When the store goes back, all are emptied. Who began to read before that may still put something in: past states,
domain versions and the timelines of prepared questions are marked with the generation in which they were read
(`Repository.generation`), and are of no use to another.

``kbstore.open(cache=False)`` turns all of them off. Beside them there are pure functions behind
`functools.lru_cache` (labelled values, the nodes of an interval tree, the compiled rules of a domain, the objects
in a text) and what is worked out once for each symbol of a domain, which goes with the domain; these depend on their
arguments alone, and are never wrong.
"""

from collections.abc import Callable, Iterable
from typing import Generic, TypeVar

TIMELINES = 200_000
QUESTIONS = 50_000
OPEN_ROWS = 50_000
ANSWERS = 50_000
STATE_ANSWERS = 1_000
ASSERTIONS = 50_000
"""The most assertions in all cached past states together; about 20 MB."""

_Key = TypeVar("_Key")
_Value = TypeVar("_Value")


class LRU(dict[_Key, _Value], Generic[_Key, _Value]):
    """A bounded cache that drops what has been used least recently.

    It has two generations: what is put goes into the younger one, and when that is half of the bound, it becomes the
    older one, and what was left in the older one is dropped. What is found in the older one moves to the younger. So
    an entry stays for at least as long as half of the bound is in use beside it, and reading the younger generation
    costs no more than reading a dict: ``cache[key]`` looks in both, and `get` in the younger one alone.

    What is dropped is released little by little, as much as is put, so that Python uses its memory for that. States of
    1,000 assertions that are released by the dozen would have its garbage collector look through all that are kept,
    which takes as long as reading them.

    There is no lock: each step is atomic, and what threads do to each other costs an entry, or the exact bound. No
    value may be None.

    Args:
        bound: how much is kept; an entry that is larger is not kept at all, and with a bound of 0 none is.
        size: the size of a value; each counts 1 if it is not given.
    """

    __slots__ = ("_bound", "_dropped", "_older", "_size", "_used")

    def __init__(self, bound: int, size: Callable[[_Value], int] | None = None) -> None:
        super().__init__()
        self._bound = bound
        self._size = size
        self._used = 0
        self._older: dict[_Key, _Value] = {}
        self._dropped: dict[_Key, _Value] = {}

    def find(self, key: _Key) -> _Value | None:
        """The value of a key, None if it is not here (any more)."""
        found = self.get(key)
        if found is None and self._older:
            found = self._older.pop(key, None)
            if found is not None:
                self.put(key, found)
        return found

    def __missing__(self, key: _Key) -> _Value:
        found = self.find(key)
        if found is None:
            raise KeyError(key)
        return found

    def put(self, key: _Key, value: _Value) -> None:
        """Keep a value; what has not been used for a long time makes room for it."""
        size = 1 if self._size is None else self._size(value)
        if size > self._bound:
            return
        if self and self._used + size > self._bound // 2:
            self._dropped, self._older = self._older, dict(self)
            super().clear()
            self._used = 0
        self._used += size
        self[key] = value
        if self._dropped:
            self._release(size)

    def _release(self, room: int) -> None:
        """Release of what has been dropped as much as takes some room."""
        while room > 0 and self._dropped:
            try:
                _, value = self._dropped.popitem()
            except KeyError:
                # another thread was first
                return
            room -= 1 if self._size is None else self._size(value)

    def drop(self, keys: Iterable[_Key]) -> None:
        """Forget some entries."""
        for key in keys:
            self.pop(key, None)
            self._older.pop(key, None)

    def clear(self) -> None:
        """Forget everything."""
        super().clear()
        self._older, self._dropped = {}, {}
        self._used = 0
