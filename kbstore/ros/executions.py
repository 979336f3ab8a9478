"""Records PlanSys2's executions of actions as runs: finds the run of an execution, and follows its status.

An execution is reported twice: at once on `actions_hub`, without an identity, and once a second on
`action_execution_info`, with the time of its start. Whichever report comes first is recorded. By their times both are
recognised as reports of one execution, even after the recorder has been restarted.
"""

from typing import Any

from kbstore.clock import SECOND, isoformat
from kbstore.clock import duration as nanoseconds
from kbstore.clock import time as stamp_time
from kbstore.knowledge_base import KnowledgeBase
from kbstore.model.results import Run
from kbstore.names import bracketed, key
from kbstore.reading.state import State
from kbstore.writing.unit_of_work import OpenTransaction

SLACK = 2 * SECOND
"""The most time, in nanoseconds, between reports of one execution; `action_execution_info` comes once a second."""

SAME_CLOCK = 86_400 * SECOND
"""Nanoseconds; a stamp further from its message's time than this is of another clock, such as a simulator's."""

NOT_EXECUTED, EXECUTING, FAILED, SUCCEEDED, CANCELLED = range(1, 6)
"""The status of an `ActionExecutionInfo`."""

CONFIRM, FINISH, CANCEL = 3, 6, 7
"""The types of an `ActionExecution` that begin or end one."""

_OUTCOMES = {FAILED: "failed", SUCCEEDED: "succeeded", CANCELLED: "cancelled"}


class Executions:
    """Records the executions of actions that are reported, each as a run."""

    def __init__(self, kb: KnowledgeBase, client: str) -> None:
        self.recorded: list[int] = []
        """The numbers of the recorded transactions; the mirror reads and clears it."""
        self._kb = kb
        self._client = client
        self._runs: dict[tuple[str, int], int] = {}
        """The number of the run of each execution, by its full name and start."""
        self._reported: dict[str, tuple[int, int]] = {}
        """The start and the status that were reported last, by full name."""
        self._durations: dict[tuple[str, ...], float] = {}
        self._plan = ""
        self._is_noted = True

    def plan(self, message: Any, *, is_noted: bool = False) -> None:
        """Take the expected durations from a plan, and its text as the note of the next start unless it `is_noted`."""
        items = list(message.items)
        text = "; ".join(f"{item.time:.3f}: {item.action} [{item.duration:.3f}]" for item in items)
        if not items or text == self._plan:
            return
        self._plan, self._is_noted = text, is_noted
        self._durations = {_words(item.action): item.duration for item in items}

    def info(self, message: Any, time: int) -> None:
        """Record the news of an `ActionExecutionInfo`."""
        name, status = message.action_full_name, message.status
        if status == NOT_EXECUTED or name == ":0":
            # the executor's entry for the initial state is :0
            return
        start = stamp_time(message.start_stamp)
        if self._reported.get(name) == (start, status):
            return
        words = self._action(message)
        run = self._find(words, name, start, time)
        if run is None:
            run = self._start(words, f"{name} executing since {isoformat(start)}", message.duration)
        if run.ended is None and status != EXECUTING:
            note = _note(f"{name} {_OUTCOMES.get(status, 'over')}", message.message_status)
            self._end(words, succeeded=status == SUCCEEDED, note=note)
        self._runs[name, start] = run.number
        self._reported[name] = (start, status)

    def hub(self, message: Any) -> None:
        """Record the start or the end that an `ActionExecution` reports."""
        if message.type not in (CONFIRM, FINISH, CANCEL):
            return
        words = self._action(message)
        text = bracketed(*words)
        if message.type == CONFIRM:
            if _running(self._kb.state(), words) is None:
                self._start(words, f"{text} confirmed to {message.node_id}")
        else:
            succeeded = message.type == FINISH and message.success
            outcome = "cancelled" if message.type == CANCEL else "succeeded" if succeeded else "failed"
            self._end(words, succeeded=succeeded, note=_note(f"{text} {outcome}", message.status))

    def _action(self, message: Any) -> tuple[str, ...]:
        """Return the operator and its arguments.

        PlanSys2 passes the name of an operator without parameters as its argument; it is left out.
        """
        arguments = tuple(message.arguments)
        if not self._kb.domain.action(message.action).parameters and arguments == (message.action,):
            arguments = ()
        return (message.action, *arguments)

    # -- which run it is --------------------------------------------------------------------------------------

    def _find(self, words: tuple[str, ...], name: str, start: int, time: int) -> Run | None:
        """Return the run that an execution is recorded as; None if it is not recorded."""
        number = self._runs.get((name, start))
        is_same_clock = abs(time - start) < SAME_CLOCK
        earliest = max(0, start - SLACK) if is_same_clock else self._kb.history_from
        found = self._kb.runs(bracketed(*words), since=earliest)
        if number is not None:
            return next((run for run in found if run.number == number), None)
        taken = set(self._runs.values())
        # a start is recorded when it is reported, never before
        free = [run for run in found if run.number not in taken and run.started >= earliest]
        if not is_same_clock:
            return free[-1] if free else None
        return min(free, key=lambda run: run.started - start, default=None)

    # -- what is recorded -------------------------------------------------------------------------------------

    def _start(self, words: tuple[str, ...], note: str, duration: Any = None) -> Run:
        if not self._is_noted:
            note = _note(note, f"plan: {self._plan}")
        if duration is None or not nanoseconds(duration):
            expected = self._durations.get(tuple(map(key, words)))
            duration = None if expected is None else _stamp(expected)
        with self._kb.transaction(client=self._client, note=note) as tx:
            # if it still runs, its end was not reported
            _stop(tx, _running(tx.state(), words), succeeded=False)
            run = tx.report_start(*words, duration=duration)
        self.recorded.append(tx.result.number)
        self._is_noted = True
        return run

    def _end(self, words: tuple[str, ...], *, succeeded: bool, note: str) -> None:
        with self._kb.transaction(client=self._client, note=note) as tx:
            _stop(tx, _running(tx.state(), words), succeeded=succeeded)
        self.recorded.append(tx.result.number)


def _running(state: State, words: tuple[str, ...]) -> Run | None:
    wanted = [*map(key, words)]
    return next((run for run in state.running if [*map(key, (run.operator, *run.arguments))] == wanted), None)


def _stop(tx: OpenTransaction, run: Run | None, *, succeeded: bool) -> None:
    if run is not None and succeeded:
        tx.report_end(run)
    elif run is not None:
        tx.abort(run)


def _words(action: str) -> tuple[str, ...]:
    return tuple(map(key, action.strip("() ").split()))


def _stamp(seconds: float) -> dict[str, int]:
    """Return a plan's duration, a float in single precision, as a ROS duration rounded to microseconds."""
    microseconds = round(seconds * 1e6)
    return {"sec": microseconds // 10**6, "nanosec": microseconds % 10**6 * 1000}


def _note(text: str, more: str) -> str:
    return f"{text}; {more}" if more else text
