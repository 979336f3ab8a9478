"""Imports a bag into a knowledge base, with the bag's times."""

import os
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path

import kbstore
from kbstore.clock import ManualClock, isoformat
from kbstore.errors import InvalidKnowledge, KbStoreError
from kbstore.knowledge_base import KnowledgeBase
from kbstore.model.domain import Domain
from kbstore.model.plain import Data, Result, times
from kbstore.model.results import Transaction
from kbstore.ros.bags.reading import PLANSYS2, Bag, Recorded, opened
from kbstore.ros.bags.rosplan_mirror import RosplanMirror
from kbstore.ros.mirror import Mirror
from kbstore.transfer.rows import Progress

Source = str | os.PathLike[str] | None


@dataclass(frozen=True)
class Imported(Result):
    """The result of an import: the knowledge base, the messages of each topic, what was recorded, and when."""

    name: str
    messages: Counter[str] = field(default_factory=Counter)
    transactions: int = 0
    since: int = 0
    until: int = 0
    left_out: tuple[str, ...] = ()

    def to_dict(self) -> Data:
        """Return it as plain data for JSON."""
        return {
            "knowledge_base": self.name,
            "messages": dict(self.messages),
            "transactions": self.transactions,
            **times(since=self.since, until=self.until),
            "left_out": list(self.left_out),
        }


def import_bag(
    path: str | os.PathLike[str],
    url: str,
    name: str | None = None,
    *,
    domain: Source = None,
    problem: Source = None,
    progress: Progress | None = None,
) -> Imported:
    """Record what a bag says in a knowledge base of its own; again, it changes nothing, and goes on where it stopped.

    Args:
        path: a rosbag1 file, the directory of a rosbag2, or its only file.
        url: the store.
        name: the knowledge base; None: the name of the bag.
        domain: PDDL text or a path. Needed once: the bag does not have it.
        problem: PDDL text or a path of a problem that declares objects, for PlanSys2, which names them without types.
        progress: called now and then with how many messages have been read, and of how many.

    Raises:
        MissingLibrary: the extra ``bags`` is not installed.
        InvalidKnowledge: it is not such a bag, the knowledge base has another history, or what a message says does not
            fit the domain. What came before that message is recorded, and the import can go on.
        UnknownSymbol: no domain is given, and the knowledge base has none.
    """
    with opened(path) as bag:
        first = next(bag.messages(), None)
        if first is None:
            raise InvalidKnowledge(f"{path} has topics of PlanSys2 or of ROSPlan, and no message on them")
        clock = ManualClock()
        name = name or _name(Path(os.path.abspath(path)))
        # tolerance 0: a time that runs backwards is an error; durability normal: what a crash loses is imported again
        with kbstore.open(url, name, clock=clock, tolerance=0, durability="normal") as kb:
            before = _latest(kb, bag, first)
            if before is None and domain is None:
                raise InvalidKnowledge(f"{path} does not have the domain; give it once (--domain domain.pddl)")
            clock.set(max(first.time, kb.now()))
            recorder = _Recorder(kb, clock, bag, domain, problem, before)
            recorder.record(progress)
            recorded = sum(1 for _ in kb.changes(after=before or 0))
            return Imported(name, recorder.counts, recorded, first.time, recorder.last, tuple(bag.others))


def _name(bag: Path) -> str:
    return bag.name if bag.is_dir() else bag.stem


def _latest(kb: KnowledgeBase, bag: Bag, first: Recorded) -> Transaction | None:
    """Return the last transaction of an earlier import; None if there is none. Refuse another history."""
    changes = list(kb.changes())
    if not changes:
        return None
    if changes[0].transaction.time != first.time:
        raise InvalidKnowledge(
            f"{kb.name} has another history, which begins at {isoformat(changes[0].transaction.time)}, and {bag.path} "
            f"begins at {isoformat(first.time)}; import it under another name"
        )
    return changes[-1].transaction


class _Recorder:
    """Feeds messages to the mirror of whoever publishes them; `before` is where an import before stopped."""

    def __init__(
        self,
        kb: KnowledgeBase,
        clock: ManualClock,
        bag: Bag,
        domain: Source,
        problem: Source,
        before: Transaction | None,
    ) -> None:
        self.counts: Counter[str] = Counter()
        self.last = 0
        self._kb = kb
        self._bag = bag
        self._since = before.time if before else 0
        self._plansys2: Mirror | None = None
        self._rosplan: RosplanMirror | None = None
        if PLANSYS2.intersection(bag.topics.values()):
            self._plansys2 = Mirror(kb, clock, domain=domain, problem=problem)
            self._learn(self._plansys2, kb.domain)
        else:
            if domain is not None:
                kb.load(domain, once=True, client="rosplan", note="the domain of ROSPlan")
            self._rosplan = RosplanMirror(kb, clock, before)

    def _learn(self, mirror: Mirror, domain: Domain) -> None:
        """Infer types from the whole bag, as later messages may determine types that earlier ones leave open."""
        for found in self._bag.messages():
            message = found.message
            # a message that does not fit the domain ends the import when it is recorded
            with suppress(KbStoreError):
                if found.kind == "knowledge" and mirror.missing_types(message):
                    mirror.learn(message)
                elif found.kind in ("info", "hub"):
                    mirror.types.observe(domain.action(message.action), message.arguments)

    def record(self, progress: Progress | None) -> None:
        """Record all messages that no earlier import has recorded."""
        done = 0
        for time, group in groupby(self._bag.messages(), key=lambda found: found.time):
            for found in _last_words(group):
                try:
                    self._take(found)
                except KbStoreError as error:
                    place = f"{self._bag.path}: {found.topic} at {isoformat(time)}"
                    raise InvalidKnowledge(*(f"{place}: {sentence}" for sentence in _sentences(error))) from error
                self.counts[found.topic] += 1
                self.last = time
                done += 1
                if progress is not None and done % 100 == 0:
                    progress(done, self._bag.count)

    def _take(self, found: Recorded) -> None:
        if self._rosplan is not None:
            self._rosplan.take(found)
            return
        assert self._plansys2 is not None
        message, time = found.message, found.time
        if found.kind == "plan":
            # a start that comes later refers to it
            self._plansys2.plan(message, is_noted=self._has_started(time))
        elif time < self._since:
            return
        elif found.kind == "knowledge":
            self._plansys2.knowledge(message, time)
        elif found.kind == "info":
            self._plansys2.action_execution_info(message, time)
        elif found.kind == "hub":
            self._plansys2.actions_hub(message, time)

    def _has_started(self, time: int) -> bool:
        """Return whether an earlier import has recorded a start at a time or later."""
        return time <= self._since and any(run.started >= time for run in self._kb.runs(since=time))


def _last_words(group: Iterable[Recorded]) -> Iterator[Recorded]:
    """Yield the messages of one time; of several snapshots only the last, which holds from then on."""
    messages = list(group)
    snapshots = [index for index, found in enumerate(messages) if found.kind in ("knowledge", "problem")]
    for index, found in enumerate(messages):
        if index not in snapshots[:-1]:
            yield found


def _sentences(error: KbStoreError) -> tuple[str, ...]:
    return error.violations if isinstance(error, InvalidKnowledge) else (str(error),)
