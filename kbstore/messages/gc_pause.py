"""Pauses the cyclic garbage collector while many objects are made."""

import gc


class gc_paused:
    """Context manager that disables the cyclic garbage collector, and enables it again if it was enabled.

    Bulk work makes many objects and no cycles, and would spend most of its time looking for cycles. This is a class,
    as a generator would cost a single transaction more than the pause saves.
    """

    __slots__ = ("_was_enabled",)

    def __enter__(self) -> None:
        self._was_enabled = gc.isenabled()
        gc.disable()

    def __exit__(self, *_: object) -> None:
        if self._was_enabled:
            gc.enable()
