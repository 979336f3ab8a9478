"""All commands of the command line, and where their functions are.

A new command is one line in `COMMANDS`. The module of its function is imported when the command is called, so that the
help, ``--version`` and the completion of commands import nothing of the store.
"""

from typing import NamedTuple

WRITE, ACT, ASK, OVER_TIME = "Write", "Act", "Ask about one time", "Ask over time"
SERVE, MAINTAIN = "Serve", "Maintain"
"""The panels of the help."""

STORE = "Store"
"""The panel for the options that name the store."""


class Command(NamedTuple):
    """A command: its name, after that of its group; ``module.function`` within `kbstore.cli`; its panel in the help.

    `line` describes it in the help of its group. The function's docstring begins with it.
    """

    name: str
    function: str
    panel: str | None
    line: str

    @property
    def group(self) -> str:
        """The group that it is in."""
        return self.name.rpartition(" ")[0] or "kbstore"


COMMANDS = [
    Command("load", "write.load", WRITE, "Load a domain and a problem from PDDL files, in one transaction."),
    Command(
        "add", "write.add", WRITE, "Add knowledge: objects, facts of both signs, values of functions. All or nothing."
    ),
    Command(
        "remove",
        "write.remove",
        WRITE,
        "Remove what matches; ? matches any object. Removing an object removes what mentions it.",
    ),
    Command("metric", "write.metric", WRITE, "Show the metric, set it, or remove it."),
    Command("apply", "act.apply", ACT, "Apply an instantaneous action: all of its effects, in one transaction."),
    Command(
        "start",
        "act.start",
        ACT,
        "Start a durative action: its at-start effects happen, and its continuous effects begin.",
    ),
    Command("end", "act.end", ACT, "End a running action: its at-end effects happen, and its continuous effects stop."),
    Command(
        "abort", "act.abort", ACT, "Abort a running action: its continuous effects stop, and nothing else happens."
    ),
    Command("state", "query.state", ASK, "Show everything that holds at a time: past, now, or expected."),
    Command("holds", "query.holds", ASK, "Show whether a fact or a condition is true."),
    Command(
        "find",
        "query.find",
        ASK,
        "List the objects for which a condition is true: one row for each binding of its ?variables.",
    ),
    Command("wait", "query.wait", ASK, "Wait until a condition is true, and show since when."),
    Command("value", "query.value", ASK, "Show the value of a numeric function or expression."),
    Command(
        "explain",
        "query.explain",
        ASK,
        "Show why a fact or a condition is true, false or unknown, since when, and who made it so.",
    ),
    Command(
        "applicable",
        "query.applicable",
        ASK,
        "Show whether an action can be applied, and if not, which conditions fail since when.",
    ),
    Command(
        "history",
        "history.history",
        OVER_TIME,
        "List all assertions that match: when each held, who recorded it, and who ended or cancelled it.",
    ),
    Command(
        "when", "history.when", OVER_TIME, "List the intervals in which a condition is true, exact to the nanosecond."
    ),
    Command(
        "runs",
        "act.runs",
        OVER_TIME,
        "List the durative actions that ran in a span: when, how they ended, and which invariants were broken.",
    ),
    Command(
        "diff",
        "history.diff",
        OVER_TIME,
        "List what became true, became false, was withdrawn, or changed between two times.",
    ),
    Command(
        "changes",
        "history.changes",
        OVER_TIME,
        "List the transactions in order, with everything that they did, and what took effect by the clock alone.",
    ),
    Command(
        "timeline",
        "history.timeline",
        OVER_TIME,
        "Draw the history: as a page for a browser, or as lanes of text within the width of the terminal.",
    ),
    Command(
        "serve",
        "serve.serve",
        SERVE,
        "Serve the store on the web, until Ctrl-C: a live timeline for people, and questions in JSON for programs.",
    ),
    Command(
        "mcp",
        "mcp.mcp",
        SERVE,
        "Offer a knowledge base to an agent, as tools by the Model Context Protocol on standard input and output.",
    ),
    Command(
        "ros plansys2",
        "ros.plansys2",
        None,
        "Take the place of PlanSys2's problem expert and domain expert, on ROS 2.",
    ),
    Command(
        "ros record",
        "ros.record",
        None,
        "Record a running PlanSys2, on ROS 2: what it knows, its goals, plans, and the actions that it executes.",
    ),
    Command(
        "ros rosplan",
        "ros.rosplan",
        None,
        "Serve a knowledge base as ROSPlan's, on ROS 1: the node rosplan_knowledge_base.",
    ),
    Command("kbs", "admin.kbs", MAINTAIN, "List the knowledge bases of the store."),
    Command(
        "export",
        "export.export",
        MAINTAIN,
        "Write the planning problem of any time, the domain, the whole knowledge base, or its record for other tools.",
    ),
    Command(
        "import",
        "admin.import_",
        MAINTAIN,
        "Restore an exported knowledge base exactly, with all its history. --kb gives it another name.",
    ),
    Command(
        "backup",
        "admin.backup",
        MAINTAIN,
        "Copy the whole store to a new SQLite file. The copy is consistent while writers go on.",
    ),
    Command(
        "archive",
        "admin.archive",
        MAINTAIN,
        "Move the history before a time into a file, which can be asked like any other store.",
    ),
    Command(
        "push",
        "push.push",
        MAINTAIN,
        "Continue a knowledge base in another store, exactly once: a robot's in a server for the fleet.",
    ),
    Command("demo", "admin.demo", MAINTAIN, "Record a robot's morning in a new file, and ask questions about it."),
    Command(
        "bag import",
        "bag.import_",
        None,
        "Record what a bag of PlanSys2 or ROSPlan says in a knowledge base of its own, with the bag's times.",
    ),
    Command(
        "bag export",
        "bag.export",
        None,
        "Write the record as MCAP with JSON messages, for Foxglove and Lichtblick.",
    ),
    Command("goal add", "write.goal_add", None, "Add goals. A conjunction is split into its parts."),
    Command("goal remove", "write.goal_remove", None, "Remove goals; ? matches any object."),
    Command(
        "db upgrade", "migrations.upgrade", None, "Upgrade the schema to that of this kbstore, in one transaction."
    ),
    Command(
        "db downgrade",
        "migrations.downgrade",
        None,
        "Go back to an earlier revision of the schema, for an earlier kbstore.",
    ),
    Command(
        "db current",
        "migrations.current",
        None,
        "Show the revision of the store's schema, and the one that this kbstore needs.",
    ),
    Command(
        "db check",
        "migrations.check",
        None,
        "Succeed if the store can be reached and has the required schema; for start-up scripts.",
    ),
    Command("db history", "migrations.history", None, "List the revisions of the schema that this kbstore knows."),
    Command(
        "db adopt",
        "push.adopt",
        None,
        "Make a copy that kbstore push has written an original, which is written to here. Later pushes are refused.",
    ),
]
