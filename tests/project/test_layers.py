"""The layers of kbstore: imports point downwards only, SQL is spoken in storage, and modules stay small."""

import ast
import re
from collections import defaultdict
from functools import cache

import pytest

from tests.project.conftest import ROOT

LAYERS = (
    ("errors",),
    ("clock", "names"),
    ("messages",),
    ("model",),
    ("conversion", "evaluation"),
    ("pddl",),
    ("planning", "interop"),
    ("storage",),
    ("reading", "sql"),
    ("writing",),
    ("transfer",),
    ("report",),
    ("knowledge_base",),
    ("api",),
    ("__init__",),
    ("aio", "ros"),
    ("serve",),
    ("cli",),
)
"""From the lowest layer to the faces; modules of one layer do not import each other."""

MOST_ROOMS = 22
MOST_LEVELS = 15
"""A newcomer keeps so many packages and modules in mind, and so many floors between the errors and the command line."""

LONGEST = 400
LONG = {
    "kbstore/knowledge_base.py": "the public interface of a knowledge base: one short method for each question",
    "kbstore/storage/assertion_queries.py": "every statement about assertions, to be reviewed at one sitting",
    "kbstore/storage/repository.py": "all that is asked of the store: one short method for each question",
    "kbstore/writing/unit_of_work.py": "the public interface of a transaction: one short method for each update",
}
"""Modules of more lines, each with the reason why it is not split."""

DRIVERS = {"sqlite3", "sqlalchemy", "psycopg", "alembic"}
NAMED = {"kbstore.api": {"Engine", "URL"}, "kbstore.cli.demo.tour": {"sqlite3"}}
"""What is imported of them elsewhere: the types of what a store is named by; the tour asks by SQL, as people do."""

SQL = re.compile(
    r"\b(SELECT\s.+\sFROM|INSERT\s+INTO|UPDATE\s+\w+\s+SET|DELETE\s+FROM|(CREATE|ALTER|DROP)\s+(TABLE|INDEX|VIEW)|PRAGMA\s)",
    re.DOTALL,
)


def module_name(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for path in sorted((ROOT / "kbstore").rglob("*.py"))}


@cache
def tree(name):
    """The syntax tree of a module."""
    return ast.parse(MODULES[name].read_text())


def imported(module, *, for_types=False):
    """What a module imports when it runs, also within functions; not what only type checkers see, unless asked for."""
    left = [module]
    while left:
        node = left.pop()
        if not for_types and isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            left += node.orelse
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, "imports name their module in full"
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                yield whole if whole in MODULES or not node.module.startswith("kbstore") else node.module
        else:
            left += (child for child in ast.iter_child_nodes(node) if not isinstance(child, ast.expr))


@cache
def imports(name):
    """What a module imports, whoever it belongs to."""
    return frozenset(imported(tree(name)))


@cache
def own_imports():
    """Which of kbstore's modules each of them imports."""
    return {name: {other for other in imports(name) if other in MODULES and other != name} for name in MODULES}


def part(name):
    """The package or module right below kbstore."""
    return name.split(".")[1] if "." in name else "__init__"


def layer(name):
    return next(index for index, parts in enumerate(LAYERS) if part(name) in parts)


def circles(needs):
    """The modules that need themselves through others, and those that need one of them."""
    while free := {name for name, others in needs.items() if not others}:
        needs = {name: others - free for name, others in needs.items() if name not in free}
    return needs


def test_every_module_has_a_layer():
    """Each package and each module right below kbstore is in one layer, and no layer has an unknown name."""
    listed = [name for parts in LAYERS for name in parts]
    assert len(listed) == len(set(listed))
    assert {part(name) for name in MODULES} == set(listed)


def test_the_picture_shows_the_layers():
    """docs/architecture.md draws each layer on a separate floor, in their order, without the package itself."""
    page = (ROOT / "docs" / "architecture.md").read_text()
    floors = [tuple(line.split("|")[1].split()) for line in page.splitlines() if line.startswith("  |  ")]
    assert floors == [rooms for rooms in reversed(LAYERS) if rooms != ("__init__",)]


def test_imports_point_downwards():
    """A module imports from lower layers, and from its own package; also where it does so late."""
    wrong = [
        f"{name} imports {other}"
        for name, others in own_imports().items()
        for other in others
        if part(name) != part(other) and layer(other) >= layer(name)
    ]
    assert not wrong


def test_no_imports_in_circles():
    """No module imports itself through others, nor within packages."""
    assert not circles(own_imports())


def test_no_two_classes_share_a_name():
    """A class is the only one of its name, except in the faces that mirror the public classes."""
    mirrors = ("kbstore.aio.", "kbstore.serve.answers", "kbstore.serve.updates")
    modules = defaultdict(list)
    for name in MODULES:
        if not name.startswith(mirrors):
            for node in ast.walk(tree(name)):
                if isinstance(node, ast.ClassDef):
                    modules[node.name].append(name)
    assert {name: found for name, found in modules.items() if len(found) > 1} == {}


def test_types_point_downwards_and_in_no_circle():
    """What a module needs for its types alone follows the same order, so that modules can be read one after another.

    Apart from the public names, whose types are those of the whole, and the converter of a `State`.
    """
    needs = {
        name: {other for other in imported(tree(name), for_types=True) if other in MODULES and other != name}
        for name in MODULES
        if name != "kbstore"
    }
    needs["kbstore.interop.unified_planning"].discard("kbstore.reading.state")
    upwards = [
        f"{name} needs {other}"
        for name, others in needs.items()
        for other in others
        if part(name) != part(other) and layer(other) >= layer(name)
    ]
    assert not upwards
    assert not circles({name: others - {"kbstore"} for name, others in needs.items()})


def test_the_house_has_few_rooms():
    """At most 22 packages and modules right below kbstore."""
    assert len({part(name) for name in MODULES} - {"__init__"}) <= MOST_ROOMS


def test_the_house_has_few_levels():
    """The longest chain of imports from room to room has at most 15 of them."""
    needs = {part(name): set() for name in MODULES}
    for name, others in own_imports().items():
        needs[part(name)] |= {part(other) for other in others} - {part(name)}

    @cache
    def height(room):
        return 1 + max(map(height, needs[room]), default=0)

    assert max(map(height, needs)) <= MOST_LEVELS, {room: height(room) for room in needs}


def test_the_model_does_not_know_the_messages():
    """The model knows the messages' enums and no message; the results of questions have messages in them."""
    results = ("kbstore.model.assertions", "kbstore.model.results", "kbstore.model.plain")
    for name, others in own_imports().items():
        if part(name) == "model" and name not in results:
            assert {other for other in others if part(other) == "messages"} <= {"kbstore.messages.enums"}, name


@pytest.mark.parametrize("name", [name for name in MODULES if part(name) not in ("sql", "storage", "transfer")])
def test_sql_is_spoken_in_storage_only(name):
    """Nothing outside of storage and the migrations has SQL in it, or imports a driver to send some."""
    drivers = {other for other in imports(name) if other.split(".")[0] in DRIVERS}
    assert {other.split(".")[-1] for other in drivers} <= NAMED.get(name, set())
    if name in NAMED:
        return
    documentation = {
        id(node.body[0].value)
        for node in ast.walk(tree(name))
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and isinstance(node.body[0], ast.Expr)
    }
    texts = [
        node.value
        for node in ast.walk(tree(name))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in documentation
    ]
    assert not [text for text in texts if SQL.search(text)]


HIDDEN = ("queries", "assertion_queries", "statements", "connection", "sqlite_connection", "postgresql_connection")
"""The modules behind the repository, the directory and the database."""


@pytest.mark.parametrize("name", [name for name in MODULES if part(name) not in ("storage", "transfer")])
def test_the_repository_is_the_way_to_the_store(name):
    """Nothing outside of storage and transfer names a statement or a connection: it asks the repository."""
    assert not own_imports()[name] & {f"kbstore.storage.{hidden}" for hidden in HIDDEN}


def test_modules_are_small():
    """A module has at most 400 lines; the exceptions have their reasons."""
    lengths = {str(path.relative_to(ROOT)): len(path.read_text().splitlines()) for path in MODULES.values()}
    assert {name for name, length in lengths.items() if length > LONGEST} == set(LONG)


def test_imports_for_type_checkers_do_not_count():
    """The tests of this file see imports wherever they are, but for those below TYPE_CHECKING."""
    module = ast.parse(
        "import kbstore.clock\n"
        "if TYPE_CHECKING:\n    import kbstore.cli\nelse:\n    from kbstore import errors\n"
        "def late():\n    from kbstore.names import key\n    from pathlib import Path\n"
    )
    assert set(imported(module)) == {"kbstore.clock", "kbstore.errors", "kbstore.names", "pathlib.Path"}
    assert SQL.search("SELECT a FROM t")
    assert not SQL.search("Select a fact from the list, or update one")
