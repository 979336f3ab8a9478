"""Random plans, made by applying applicable actions in a knowledge base."""

import random
from collections.abc import Iterator
from contextlib import suppress
from itertools import product

from kbstore import KnowledgeBase, ManualClock, NotApplicable, Run, seconds
from kbstore.clock import SECOND
from kbstore.interop.plans import Happening, Step, in_order, timed_steps

STEP = SECOND // 8


def walk(kb: KnowledgeBase, clock: ManualClock, rng: random.Random, length: int, *, finish: bool = True) -> list[Step]:
    """Do `length` random actions, several of them at once, each step at a separate time.

    Returns the steps, with times from the beginning of the walk. With `finish`, all runs have ended.
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


def good_or_bad(kb: KnowledgeBase, clock: ManualClock, rng: random.Random) -> list[Step]:
    """A plan for the tanks, good or bad: most actions are applicable when they begin; no two steps are at one time."""
    begin, t, busy, steps = clock.now(), 0, set[int](), list[Step]()
    running: dict[tuple[str, ...], int] = {}

    def unused(at: int) -> int:
        while at in busy:
            at += STEP // 4
        busy.add(at)
        return at

    for _ in range(rng.randint(4, 9)):
        t = unused(t + rng.randint(1, 16) * STEP)
        clock.set(begin + t)
        choices = [call for call in _calls(kb) if running.get((call[0], *call[1]), -1) < t]
        rng.shuffle(choices)
        likely = [call for call in choices if kb.applicable(call[0], *call[1])] if rng.random() < 0.8 else []
        # durative actions have invariants to break
        lasting = rng.random() < 0.6
        name, names = min(likely or choices, key=lambda call: kb.domain.action(call[0]).durative != lasting)
        duration = None
        if name == "cure":
            duration = round(seconds(kb.value(f"(limit {names[0]})") / 2)) + rng.choice([0, 0, 0, STEP])
            busy.add(t + duration)
        elif kb.domain.action(name).durative:
            duration = unused(t + rng.randint(4, 48) * STEP) - t
        running[name, *names] = t + (duration or 0)
        steps += timed_steps(name, names, t, duration)
        with suppress(NotApplicable):  # so that the next step is chosen knowing the effect of this one
            if duration is None:
                kb.apply(name, *names)
            else:
                kb.start(name, *names, duration=duration)
    return in_order(steps)


def _choose(kb: KnowledgeBase, rng: random.Random) -> tuple[str, tuple[str, ...], int | None] | None:
    """An operator that is applicable now and not running, with its arguments and duration."""
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
    """None for an instantaneous action; the fixed duration; or a random one from 2 to 6 seconds."""
    action = kb.domain.action(operator)
    if not action.durative:
        return None
    if operator == "travel":
        return round(seconds(12) / kb.value(f"(speed {arguments[0]})"))
    return seconds(7) if operator == "drip" else rng.randint(16, 48) * STEP
