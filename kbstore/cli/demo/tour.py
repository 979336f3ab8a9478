"""The questions of the demonstration, and their answers on a terminal."""

import sqlite3
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from itertools import count
from pathlib import Path

from rich.console import Console, RenderableType
from rich.padding import Padding
from rich.rule import Rule
from rich.text import Text

from kbstore.cli.demo.mission import END, NAME, START, moment, record
from kbstore.errors import StoreUnavailable
from kbstore.knowledge_base import KnowledgeBase
from kbstore.messages import format_number
from kbstore.report import records, states
from kbstore.report.tables import DIM, TITLE, sections, show, table
from kbstore.report.time_format import TimeFormat

WIDTH = 118
"""The width of the longest line; a narrower terminal folds it."""

CHANGING = ("robot_at", "open", "carries", "parcel_at", "delivered", "docked", "undocked")
"""The predicates that are not part of the building's map."""

SQL = """\
SELECT fact, substr(initial_time, 12, 8) AS since, substr(end_time, 12, 8) AS until, recorded_client
FROM fact_history WHERE name = 'robot_at' ORDER BY initial_ns"""


@dataclass(frozen=True, slots=True)
class Answer:
    """A question, the Python that asks it, and the answer."""

    question: str
    code: str
    shown: RenderableType


def tour(kb: KnowledgeBase) -> Iterator[Answer]:
    """Ask what a knowledge base with only a current state cannot answer."""
    at_end = TimeFormat(kb.now(), brief=True)
    alarm, before = moment("09:02:00"), moment("09:00:45")
    yield Answer(
        "What was true at 09:02:00, while the fire alarm was on?",
        'kb.state(at="2026-05-04T09:02:00Z")',
        past_state(kb, alarm),
    )
    yield Answer(
        "Fifteen seconds before the alarm: what did kenny expect of 09:02:00, and what came?",
        "kb.state(at=alarm, as_of=before)",
        expectation(kb, alarm, before),
    )
    yield Answer(
        "The history of one fact: who opened and closed the laboratory, and what was scheduled and cancelled?",
        'kb.history("(open lab_door)")',
        records.history_table(kb.history("(open lab_door)"), at_end),
    )
    yield Answer(
        "What changed from 08:59:00 to 09:06:00?",
        'kb.diff("2026-05-04T08:59:00Z", "2026-05-04T09:06:00Z")',
        records.diff_view(kb.diff(moment("08:59:00"), moment("09:06:00"))),
    )
    yield Answer(
        "When was the battery below 20 percent? It moves at a rate; the answer is exact to the nanosecond.",
        'kb.when("(< (battery kenny) 20)", since=start, until=end)',
        records.intervals_table(kb.when("(< (battery kenny) 20)", START, END), at_end),
    )
    yield Answer(
        "Why is the linen not in the office?",
        'kb.explain("(parcel_at linen office)")',
        records.explanation_tree(kb.explain("(parcel_at linen office)"), at_end),
    )
    yield Answer(
        "Could kenny have passed the door at 09:02:00?",
        'kb.applicable("pass_door", "kenny", "lab_door", "corridor", "lab", at=alarm)',
        records.applicability_view(
            "(pass_door kenny lab_door corridor lab)",
            kb.applicable("pass_door", "kenny", "lab_door", "corridor", "lab", at=alarm),
            TimeFormat(alarm, brief=True),
        ),
    )
    yield Answer(
        "How often did it try to pass the door, and was the door open all the while?",
        'kb.runs("(pass_door kenny ? ? ?)")',
        records.runs_view(kb.runs("(pass_door kenny ? ? ?)")),
    )
    yield Answer(
        "And the future: how long will the door stay open?",
        'kb.when("(open lab_door)", since=kb.now(), until=kb.now() + seconds(3600))',
        records.intervals_table(kb.when("(open lab_door)", END, END + 3600 * 10**9), at_end),
    )


def past_state(kb: KnowledgeBase, t: int) -> RenderableType:
    """Show the state at a time, without the building's map."""
    state, moments = kb.state(at=t), TimeFormat(t, brief=True)
    changing = [fact for fact in state.facts if fact.attribute_name in CHANGING]
    static = len(state.facts) - len(changing) + len(state.functions) - 1
    battery = f"(battery kenny) is {format_number(state.value('(battery kenny)'))}"
    return sections(
        states.facts(changing, moments),
        Text(f"{battery}; and {static} facts and numbers of the building, the same throughout", DIM),
        states.scheduled(state.timed_knowledge, moments),
        states.goals(state, state.goals, moments),
    )


def expectation(kb: KnowledgeBase, t: int, believed_at: int) -> RenderableType:
    """Show what had been expected of a time, beside what came."""
    belief, fact = kb.state(at=t, as_of=believed_at), kb.state(at=t)
    conditions = ("(robot_at kenny lab)", "(robot_at kenny corridor)", "(open lab_door)")
    rows = [(text, str(belief.truth(text)), str(fact.truth(text))) for text in conditions]
    battery = [format_number(state.value("(battery kenny)")) for state in (belief, fact)]
    rows.append(("(battery kenny)", battery[0], battery[1]))
    return table("", ("at 09:02:00", "expected at 09:00:45", "what came"), rows)


def present(kb: KnowledgeBase, file: Path, console: Console) -> None:
    """Show the whole demonstration, for a mission recorded in a file."""
    moments = TimeFormat(kb.now(), brief=True)
    console.print(Text.assemble(("kbstore: a bitemporal knowledge base for robot planning", TITLE), "\n"))
    show(
        console,
        "On the morning of 2026-05-04 kenny, a porter robot, has to bring two parcels to the laboratory. One is "
        "withdrawn, and a fire alarm shuts the door in front of it. What was recorded, one line for each "
        "transaction:\n",
    )
    show(console, records.log_table((change.transaction for change in kb.changes()), moments))
    for number, answer in enumerate(tour(kb), 1):
        console.print()
        heading(f"{number}. {answer.question}", console)
        console.print(Text(f">>> {answer.code}", DIM))
        show(console, Padding(answer.shown, (1, 0, 0, 2)))
    console.print()
    heading("Explore the file yourself", console)
    page = page_beside(file)
    kb.timeline(page)
    closing_words(file, page, console)


def heading(text: str, console: Console) -> None:
    """Show a line across, and a title that may be folded."""
    show(console, Rule(style=DIM), Text(text, TITLE))


def closing_words(file: Path, page: Path, console: Console) -> None:
    """Show where the file is, a statement to try in SQL with its answer, commands to try, and where the page is."""
    command = Path(sys.executable).with_name("kbstore")
    if command.is_relative_to(Path.cwd()):
        command = command.relative_to(Path.cwd())
    store = f"{command} --url {file} --kb {NAME}"
    with closing(sqlite3.connect(file)) as connection:
        cursor = connection.execute(SQL)
        headings = [column[0] for column in cursor.description]
        rows = [tuple(str(cell or "") for cell in row) for row in cursor]
    console.print(Text(f"{file}\n", TITLE), soft_wrap=True)
    console.print("In SQL, with sqlite3 or any other client:\n")
    show(console, Padding(Text(SQL, DIM), (0, 2)))
    console.print()
    show(console, Padding(table("", headings, rows), (0, 2)))
    console.print("\nOn the command line:\n")
    for arguments in (
        "state --at 2026-05-04T09:02:00Z",
        "explain '(carries kenny blood)'",
        "export --at 2026-05-04T09:02:00Z",
        "timeline --now last",
        "--help",
    ):
        console.print(Text(f"  {store if arguments != '--help' else command} {arguments}"), soft_wrap=True)
    console.print("\nThe morning as a picture, to be opened in a browser:\n")
    console.print(Text(str(page), TITLE), soft_wrap=True)


def new_file() -> Path:
    """Return a file that does not exist yet: here, or if nothing can be written here, a temporary one."""
    directory = Path.cwd()
    try:
        with tempfile.TemporaryFile(dir=directory):
            pass
    except OSError:
        directory = Path(tempfile.mkdtemp(prefix="kbstore-demo-"))
    names = ("kbstore-demo.db" if number == 1 else f"kbstore-demo-{number}.db" for number in count(1))
    return next(path for name in names if not (path := directory / name).exists())


def page_beside(file: Path) -> Path:
    """Return a file that does not exist yet, for the page of the timeline."""
    names = (f"{file.stem}.html" if number == 1 else f"{file.stem}-{number}.html" for number in count(1))
    return next(path for name in names if not (path := file.with_name(name)).exists())


def unused(file: Path | None) -> Path:
    """Return the file, or a new one if none is named. Raises `StoreUnavailable` if it exists."""
    path = new_file() if file is None else file
    if path.exists():
        raise StoreUnavailable(f"{path} exists already; name one that does not, as the demonstration creates it")
    return path


def run(file: Path | None = None, console: Console | None = None) -> Path:
    """Record the mission in a new file, show everything, and return it. Raises `StoreUnavailable` if it exists."""
    path = unused(file)
    shown = console or Console(highlight=False)
    if shown.width > WIDTH or not shown.is_terminal:
        shown.width = WIDTH
    with record(f"sqlite:///{path}") as kb:
        present(kb, path, shown)
    return path
