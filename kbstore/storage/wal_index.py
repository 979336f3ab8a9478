"""Whether anybody has committed to an SQLite file, seen without a statement.

All processes that have a file open in WAL mode share the WAL-index, whose header each commit writes anew; SQLite
itself compares it with what it saw last. So does ``PRAGMA data_version``, in more time than everything else that an
answer from memory needs. Source: https://www.sqlite.org/walformat.html, section 2.1.

The header is read where SQLite has it in this process's memory, which Linux tells; the file itself must not be opened,
for closing it would drop SQLite's locks on it. Where it is not found, or not for certain, the statement is used.
"""

import ctypes
import os
import sys
from typing import Final, Protocol

_VERSION: Final = 3007000
"""The only version of the WAL-index that there has been since SQLite 3.7."""

_SIZE: Final = 48
"""Bytes of the header; a commit changes its counter and its checksums."""

_MAPS: Final = "/proc/self/maps"


class Header(Protocol):
    """Bytes that are others after each commit."""

    @property
    def raw(self) -> bytes:
        """What they are now."""


class Unshared:
    """The header of a store that nobody else can reach."""

    raw = b""


def find_header(path: str | None) -> Header | None:
    """The header of the WAL-index of a file, None if it cannot be found.

    It may be read as long as the connection is open that asks for it, which must have read from the file in WAL mode.
    """
    if path is None:
        return None
    shared = f"{os.path.realpath(path)}-shm"
    try:
        inode = os.stat(shared).st_ino
        with open(_MAPS, encoding="utf-8", errors="surrogateescape") as maps:
            lines = [line.split(maxsplit=5) for line in maps if line.endswith("-shm\n")]
    except OSError:
        return None
    # addresses, permissions, offset, device, inode, name
    found = [
        line[0].partition("-")[0]
        for line in lines
        if line[5] == f"{shared}\n" and int(line[4]) == inode and not int(line[2], 16)
    ]
    # if another copy of SQLite has it open, too, nothing says which is which
    if len(found) != 1:
        return None
    header: Header = (ctypes.c_char * _SIZE).from_address(int(found[0], 16))
    return header if int.from_bytes(header.raw[:4], sys.byteorder) == _VERSION else None
