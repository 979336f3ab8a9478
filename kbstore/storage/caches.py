"""The one class of caches in kbstore, and a list of all its caches.

=====================  =============================  ========================  =====================================
what                   key                            bound                     dropped when
=====================  =============================  ========================  =====================================
timelines              number; role, kind and key     200,000                   never wrong: a timeline never changes,
                                                                                nor does the message of its latest row
keys without a         role, kind and key             50,000                    a timeline is added
timeline
domain versions        version number                 all                       never wrong: a version never changes
prepared questions     domain version and question    50,000                    never wrong: made anew for a version
past states            valid time                     50,000 assertions         late knowledge reaches their time
open rows              number of a timeline           50,000                    somebody else writes
answers about now      question; for a connection,    50,000                    somebody commits, or a notification of
                       or while notified                                        that arrives; a part changes by the
                                                                                clock
parts of the present   which part; the same           50,000 assertions         the same
answers of a `State`   question                       1,000 of each state       never wrong: a state never changes
=====================  =============================  ========================  =====================================

When the store goes back, all are emptied. A thread that began to read before that may still add an entry: past states,
domain versions and the timelines of prepared questions are marked with the generation in which they were read
(`Repository.generation`), and are ignored in another.

``kbstore.open(cache=False)`` turns all of them off. Besides them, pure functions are cached by `functools.lru_cache`
(labelled values, the nodes of an interval tree, the compiled rules of a domain, the objects in a text), and so is what
is computed once for each symbol of a domain; these depend on their arguments alone, and are never wrong.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Generic, TypeVar

TIMELINES = 200_000
ABSENT = 50_000
QUESTIONS = 50_000
OPEN_ROWS = 50_000
ANSWERS = 50_000
STATE_ANSWERS = 1_000
ASSERTIONS = 50_000
"""The most assertions in all cached past states together; about 20 MB."""

_Key = TypeVar("_Key")
_Value = TypeVar("_Value")


class LRU(dict[_Key, _Value], Generic[_Key, _Value]):
    """A bounded cache that drops the entries used least recently.

    It has two generations. New entries go into the younger one; when that has reached half of the bound, it becomes the
    older one, and the rest of the older one is dropped. An entry found in the older one moves to the younger. So an
    entry stays at least until entries of half the bound have been used after it, and reading the younger generation
    costs no more than reading a dict: ``cache[key]`` looks in both, and `get` in the younger one alone.

    Dropped entries are released little by little, as new ones come, so that Python reuses their memory. If states of
    1,000 assertions were released by the dozen, its garbage collector would go through all that are cached, which takes
    as long as reading them.

    There is no lock: each step is atomic, and threads that interfere cost an entry, or the exact bound. No value may
    be None.

    Args:
        bound: the most that is cached, in sizes of values; a larger value is not cached, and with 0 none is.
        size: returns the size of a value; each counts 1 if it is not given.
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
        """Return the value of a key; None if it is not cached, or not any more."""
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
        """Cache a value, and drop entries that have not been used for a long time if it needs their room."""
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

    def put_all(self, values: Mapping[_Key, _Value]) -> None:
        """Cache values of size 1, many of which fit at once into the younger generation."""
        room = self._bound // 2 - self._used
        if len(values) <= room:
            self._used += len(values)
            self.update(values)
            if self._dropped:
                self._release(len(values))
        else:
            for key, value in values.items():
                self.put(key, value)

    def _release(self, room: int) -> None:
        """Release dropped entries of a total size of `room`."""
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


class AnswerCache:
    """Cached answers about now: truths, values, and other values computed from the state.

    They are as of the commit with the token `token`; None if that is not known.
    """

    __slots__ = ("computed", "token", "truths", "values")

    def __init__(self) -> None:
        self.token: int | None = None
        self.computed: LRU[Any, Any] = LRU(ASSERTIONS, lambda found: found[1].size)
        self.truths: LRU[Any, Any] = LRU(ANSWERS)
        self.values: LRU[Any, Any] = LRU(ANSWERS)

    def clear(self) -> None:
        """Forget everything."""
        self.computed.clear()
        self.truths.clear()
        self.values.clear()
