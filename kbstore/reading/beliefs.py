"""Beliefs about one valid time, over transaction time (rule L4)."""

from kbstore.clock import TimeLike, time
from kbstore.messages import KnowledgeType, Truth
from kbstore.model.domain import Domain
from kbstore.model.formulas import Exists, Forall, Formula, IsA, walk
from kbstore.model.timelines import Role, Timeline
from kbstore.names import key
from kbstore.reading.prepared import atoms_in, ground_key
from kbstore.reading.questions import Question
from kbstore.reading.reader import Reader
from kbstore.reading.resolver import TemporalPoint
from kbstore.storage.repository import Repository

Belief = tuple[int, int | None, Truth]
"""A span of transaction time, half-open and with None for what is still believed, and the truth that was believed."""


def beliefs(reader: Reader, repository: Repository, condition: Question, at: TimeLike) -> list[Belief]:
    """Return the truth of a condition at one time as it was believed, from the first transaction to now."""
    now = reader.resolver.resolve(repository)
    t = time(at, now.valid_time)
    symbols = reader.symbol_table(repository, now.head, now.position)
    prepared = reader.questions.condition(condition, symbols)
    found: list[Belief] = []
    moments = _moments(repository, now, prepared.formula, symbols.domain, t)
    while moments:
        moment = moments.pop(0)
        point = reader.resolver.resolve(repository, t, moment)
        domain = reader.symbol_table(repository, point.head, point.position).domain
        truth = prepared.evaluate(reader.world(repository, point, domain))
        if not found:
            found.append((moment, None, truth))
        elif found[-1][2] is not truth:
            found[-1] = (found[-1][0], moment, found[-1][2])
            found.append((moment, None, truth))
        # a run is expected to end, and once that time has come without its end, the expectation changes
        until = moments[0] if moments else now.valid_time + 1
        expected = {run.started + run.duration for run in point.running}
        moments[:0] = sorted(end for end in expected if moment < end < until)
    return found


def _moments(repository: Repository, now: TemporalPoint, formula: Formula, domain: Domain | None, at: int) -> list[int]:
    """Return the times of the transactions that may have changed the belief about a time, and that time itself."""
    head = now.head
    first = repository.first_transaction_from(head.history_from)
    if first is None:
        return []
    numbers = {first}
    timelines = _timelines(repository, formula, domain)
    if timelines is None or head.last_run:
        # runs have expected effects, and derived predicates may read any timeline
        numbers = set(range(first, head.number + 1))
    else:
        numbers |= {row[2] for row in repository.domain_versions()}
        for kind in {timeline.kind for timeline in timelines}:
            rows = repository.history(kind, [timeline for timeline in timelines if timeline.kind is kind], 0, at + 1)
            for row in rows:
                numbers |= {row.recorded, row.ended or 0, row.cancelled or 0, row.superseded or 0}
            keys = {(row.recorded, row.seq) for row in rows}
            revisions = repository.revisions(kind, 0, head.number)
            numbers |= {revision.number for revision in revisions if (revision.recorded, revision.seq) in keys}
    times = {row[1] for row in repository.transactions(numbers) if row[1] >= head.history_from}
    return sorted(times | ({at} if min(times) < at <= now.valid_time else set()))


def _timelines(repository: Repository, formula: Formula, domain: Domain | None) -> list[Timeline] | None:
    """Return the timelines that may decide a condition; None if that may be any."""
    found: list[Timeline] = []
    # quantifiers, wildcards and types depend on which objects exist
    asks_for_objects = any(isinstance(node, Exists | Forall | IsA) for node, _, _ in walk(formula, {}))
    for kind, atom in atoms_in(formula):
        if kind is KnowledgeType.FACT and domain is not None and domain.is_derived(atom.name):
            return None
        ground = ground_key(atom)
        if ground is None:
            asks_for_objects = True
            found += repository.of_symbol(Role.STATE, kind, key(atom.name))
        else:
            found += repository.find(Role.STATE, kind, [ground]).values()
    return found + repository.of_kind(Role.STATE, KnowledgeType.INSTANCE) if asks_for_objects else found
