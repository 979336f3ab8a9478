"""Derived rates ahead, for a copy that has been brought to a transaction that is not its source's last.

What is derived for later times (rule O5) is deleted and derived again by later transactions, and of an earlier one it
is not stored any more. The copy derives it as the source did.
"""

from kbstore.reading.domains import DomainVersions
from kbstore.reading.mentions import mentions
from kbstore.reading.reader import as_running
from kbstore.storage.records import Head, LogPosition
from kbstore.storage.repository import Repository
from kbstore.writing.action_executor import ActionExecutor
from kbstore.writing.change_set import ChangeSet
from kbstore.writing.flush import Flush
from kbstore.writing.working_state import WorkingState


def derive_rates(repository: Repository, head: Head, *, use_unknowns: bool) -> None:
    """Derive how numbers move from the time of the head on, by what runs; in the transaction that has put the head."""
    position = LogPosition(head.time)
    running = [as_running(row) for row in repository.running(position)]
    if not running:
        return
    domain = DomainVersions(caching=False).in_force(repository, head, position).domain
    change_set = ChangeSet(repository, head.time, mentions)
    executor = ActionExecutor(change_set, running, head.last_run)
    WorkingState(repository, change_set, executor, domain, use_unknowns=use_unknowns).follow_rates(domain, anew=True)
    repository.save_derived(Flush(change_set, repository).rows(), head)
