"""Reads transactions as people write them, to name a belief: ``tx12`` or ``#12``."""

import re
from contextlib import suppress
from typing import TYPE_CHECKING

from kbstore.errors import InvalidTime, StoreWentBack
from kbstore.model.results import Transaction

if TYPE_CHECKING:
    from kbstore.report.source import RecordSource


def named_transaction(text: str, kb: "RecordSource") -> Transaction | None:
    """Return the transaction that ``tx12`` or ``#12`` names; None for any other text.

    Raises `InvalidTime` if there is no transaction of that number.
    """
    numbered = re.fullmatch(r"(?:tx|#)([0-9]{1,18})", text.strip().lower())
    if numbered is None:
        return None
    number = int(numbered[1])
    with suppress(StoreWentBack):
        for change in kb.changes(after=number - 1) if number else ():
            if change.number == number:
                return change.transaction
            break
    raise InvalidTime(f"{kb.name} has no transaction {number}; kbstore changes lists them")
