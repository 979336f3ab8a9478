"""Which modules are imported: a program that needs a part of kbstore does not wait for all of it."""

import ast
import subprocess
import sys

import pytest

import kbstore
from tests.project.conftest import ROOT

HEAVY = {"sqlalchemy", "alembic", "pydantic", "psycopg", "typer", "rich", "unified_planning"}
"""The dependencies that take longest to import."""

COMMAND = "import sys; from kbstore.cli import main; sys.argv[0] = 'kbstore'; main()"


def modules(code, *arguments, **environment):
    """The modules that a Python program has imported when it ends."""
    ending = "import atexit, sys; atexit.register(lambda: print(*sorted(sys.modules), file=sys.stderr, sep='\\n'))\n"
    call = [sys.executable, "-c", ending + code, *arguments]
    done = subprocess.run(call, capture_output=True, text=True, cwd=ROOT, env={"PATH": "", **environment}, check=True)
    return set(done.stderr.splitlines())


def packages(found):
    return {name.partition(".")[0] for name in found}


def rooms(found):
    """The packages and modules right below kbstore that are among modules."""
    return {name.split(".")[1] for name in found if name.startswith("kbstore.")}


def test_importing_kbstore_imports_what_is_used_of_it():
    """`import kbstore` imports nothing else; a public name brings its modules, and the errors need none."""
    found = modules("import kbstore")
    assert not packages(found) & HEAVY
    assert rooms(found) == set()
    assert rooms(modules("from kbstore import Conflict")) == {"errors"}


def test_opening_a_store_imports_nothing_for_moving_it(tmp_path):
    """Neither the migrations of one that is set up, nor the statements that carry a whole store elsewhere."""
    opening = f"import kbstore; kbstore.open({str(tmp_path / 'store.db')!r}).close()"
    modules(opening)
    found = modules(opening)
    assert "alembic" not in packages(found)
    assert {name for name in found if name.startswith("kbstore.transfer.")} == {"kbstore.transfer.archive_mark"}


def test_each_public_name_has_one_home():
    """Type checkers, the interpreter and `__all__` have the same names, from the same modules."""
    tree = ast.parse((ROOT / "kbstore" / "__init__.py").read_text())
    (seen,) = (node.body for node in tree.body if isinstance(node, ast.If))
    homes = {alias.asname or alias.name: f"{node.module}.{alias.name}" for node in seen for alias in node.names}
    assert homes == kbstore._HOMES
    assert sorted(homes) == sorted(kbstore.__all__)
    assert set(homes) <= set(dir(kbstore))


def test_an_unknown_name_is_an_attribute_error():
    """Modules are attributes of the package, as after their import; any other name is an AttributeError."""
    assert modules("import kbstore; kbstore.errors.Conflict") >= {"kbstore.errors"}
    with pytest.raises(AttributeError, match="kbstore has no name 'opne'"):
        kbstore.opne  # noqa: B018


def test_a_command_collects_its_own_garbage():
    """Imported modules are left out of every collection, which would take most of the time; later objects are not."""
    ending = "import atexit, gc; atexit.register(lambda: print(gc.isenabled(), gc.get_freeze_count() > 10_000))\n"
    call = [sys.executable, "-c", ending + COMMAND, "holds", "--help"]
    done = subprocess.run(call, capture_output=True, text=True, cwd=ROOT, check=True)
    assert done.stdout.split()[-2:] == ["True", "True"]


@pytest.mark.parametrize("option", ["--version", "--help"])
def test_version_and_help_import_the_command_line_alone(option):
    """They import the command line and its errors."""
    found = modules(COMMAND, option)
    assert not packages(found) & (HEAVY - {"typer", "rich"})
    assert rooms(found) == {"cli", "errors"}


@pytest.mark.parametrize("words", ["kbstore sta", "kbstore db up"])
def test_completion_of_commands_imports_nothing_of_the_store(words):
    """Neither among all commands nor in a group; typer itself needs Pydantic."""
    last = str(len(words.split()) - 1)
    found = modules(COMMAND, _KBSTORE_COMPLETE="complete_bash", COMP_WORDS=words, COMP_CWORD=last)
    assert not packages(found) & (HEAVY - {"typer", "pydantic"})
    assert rooms(found) == {"cli", "errors"}


def test_checking_a_schema_imports_no_knowledge_base(tmp_path):
    """Whoever waits for a store that others upgrade asks often, and about its tables alone."""
    store = str(tmp_path / "store.db")
    modules(f"import kbstore; kbstore.open({store!r}).close()")
    found = modules(COMMAND, "db", "check", "--url", store)
    assert "alembic" not in packages(found)
    assert not rooms(found) & {"knowledge_base", "reading", "writing", "evaluation", "planning", "pddl", "transfer"}
