"""Random plans, made by trying what is applicable in a knowledge base and doing it."""

import random
from collections.abc import Iterator
from itertools import product

from kbstore import KnowledgeBase, ManualClock, Run, seconds
from kbstore.clock import SECOND
from kbstore.interop.plans import Happening, Step

STEP = SECOND // 8


def walk(kb: KnowledgeBase, clock: ManualClock, rng: random.Random, length: int, *, finish: bool = True) -> list[Step]:
    """Do `length` random actions, several of them at once, each happening at a time of its own.

    Returns what was done, with times from the beginning of the walk. With `finish`, all that was started has ended.
    """
    begin, busy = clock.now(), {item.initial_time for item in kb.timed_knowledge()}
    done: list[Step] = []
    running: dict[int, Run] = {}

    def end_until(t: int) -> None:
        for at in sorted(at for at in running if at <= t):
            clock.set(at)
            run = running.pop(at)
            kb.end(run)
            done.append(Step(Happening.END, run.operator, run.arguments, at - begin, run.duration))

    def unused(earliest: int) -> int:
        at = earliest
        while at in busy:
            at += 50_000  # the validator accepts a duration that is off by less than a millisecond
        busy.add(at)
        return at

    t = begin
    while length:
        t = unused(t + rng.randint(1, 24) * STEP)
        end_until(t)
        clock.set(t)
        choice = _choose(kb, rng)
        if choice is None:
            assert running, "nothing is applicable, and nothing runs"
            t = min(running)
            continue
        operator, arguments, lasts = choice
        if lasts is None:
            kb.apply(operator, *arguments)
            done.append(Step(Happening.APPLY, operator, arguments, t - begin))
        else:
            end = unused(t + lasts)
            run = kb.start(operator, *arguments, duration=end - t)
            running[end] = run
            done.append(Step(Happening.START, operator, arguments, t - begin, run.duration))
        length -= 1
    if finish:
        end_until(max(running, default=t))
    return done


def _choose(kb: KnowledgeBase, rng: random.Random) -> tuple[str, tuple[str, ...], int | None] | None:
    """An operator that is applicable now and does not run yet, with its arguments and how long it is to take."""
    state = kb.state()
    runs = {(run.operator, run.arguments) for run in state.running}
    choices = list(_calls(kb))
    rng.shuffle(choices)
    for operator, arguments in choices:
        if (operator, arguments) not in runs and kb.applicable(operator, *arguments):
            return operator, arguments, _length(kb, operator, arguments, rng)
    return None


def _calls(kb: KnowledgeBase) -> Iterator[tuple[str, tuple[str, ...]]]:
    state = kb.state()
    for action in kb.domain.actions.values():
        for arguments in product(*(state.objects(p.types[0]) for p in action.parameters)):
            yield action.name, arguments


def _length(kb: KnowledgeBase, operator: str, arguments: tuple[str, ...], rng: random.Random) -> int | None:
    """Nothing for what takes no time; what the domain fixes; or something from 2 to 6 seconds."""
    action = kb.domain.action(operator)
    if not action.durative:
        return None
    if operator == "travel":
        return round(seconds(12) / kb.value(f"(speed {arguments[0]})"))
    return seconds(7) if operator == "drip" else rng.randint(16, 48) * STEP
