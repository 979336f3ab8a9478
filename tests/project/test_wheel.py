"""What is installed works without the checkout."""

import zipfile

import pytest

from kbstore.storage import schema


def test_the_wheel_holds_what_is_needed(wheel):
    """The wheel has the package, its migrations, the marker for type checkers and the licence, and nothing else."""
    names = zipfile.ZipFile(wheel).namelist()
    page = [f"report/timeline/page.{kind}" for kind in ("html", "css", "js")]
    for needed in ("__init__.py", "py.typed", "migrations/env.py", "migrations/versions/0001_tables.py", *page):
        assert f"kbstore/{needed}" in names
    assert any(name.endswith("licenses/LICENSE") for name in names)
    assert {name.partition("/")[0].partition("-")[0] for name in names} == {"kbstore"}
    assert not [name for name in names if "__pycache__" in name or name.endswith(".db")]


@pytest.mark.parametrize("engine", ["sqlite", "postgresql"])
def test_an_installed_kbstore_migrates(installed, engine, request, tmp_path):
    """Away from the checkout, an empty database is set up, refused when it is old, and upgraded."""
    url = request.getfixturevalue("postgresql_url") if engine == "postgresql" else f"sqlite:///{tmp_path / 'store.db'}"
    name = repr("installed") if engine == "postgresql" else None
    code = f"""
import kbstore
from kbstore.errors import SchemaOutOfDate
from kbstore.storage import schema
assert "venv" in kbstore.__file__, kbstore.__file__
url, name = {url!r}, {name}
print(schema.upgrade(url, "0001", schema=name).after)
try:
    schema.check(url, schema=name)
except SchemaOutOfDate:
    print("refused")
print(schema.upgrade(url, schema=name).after, schema.current(url, schema=name))
print(schema.downgrade(url, "base", schema=name).after)
"""
    assert installed(code=code) == (0, f"0001\nrefused\n{schema.HEAD} {schema.HEAD}\nNone\n", "")
