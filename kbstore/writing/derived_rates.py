"""Derives the rates of numbers at later times, in a copy that does not go as far as its original.

Later transactions delete what earlier ones derived for later times (rule O5), and derive it anew. So the original does
not have any more what was derived at the copy's last transaction, and the copy derives it itself.
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
    """Derive how runs move numbers from the time of the head on; called in the transaction that wrote the head."""
    position = LogPosition(head.time)
    running = [as_running(row) for row in repository.running(position)]
    if not running:
        return
    domain = DomainVersions(caching=False).in_force(repository, head, position).domain
    change_set = ChangeSet(repository, head.time, mentions)
    executor = ActionExecutor(change_set, running, head.last_run)
    WorkingState(repository, change_set, executor, domain, use_unknowns=use_unknowns).follow_rates(domain, anew=True)
    repository.save_derived(Flush(change_set, repository).rows(), head)
