"""Bulk work: what makes very many objects at once."""

import gc


class gc_paused:
    """Bulk work makes many objects and no cycles; looking for cycles among them takes most of the time.

    A class, as single transactions use it, too, and a generator would cost them more than it saves.
    """

    __slots__ = ("_was_enabled",)

    def __enter__(self) -> None:
        self._was_enabled = gc.isenabled()
        gc.disable()

    def __exit__(self, *_: object) -> None:
        if self._was_enabled:
            gc.enable()
