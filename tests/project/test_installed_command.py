"""The command `kbstore` of an installed wheel: set up, load, ask, upgrade, away from the checkout."""

import json

import pytest

from kbstore.cli.demo import mission
from kbstore.storage import schema


@pytest.mark.parametrize("engine", ["sqlite", "postgresql"])
def test_an_installed_command_sets_up_loads_and_asks(installed, engine, request, tmp_path):
    """On both engines: an old schema is upgraded, a domain and a problem are loaded, and questions are answered."""
    if engine == "postgresql":
        url = request.getfixturevalue("postgresql_url")
        place = ("--url", schema.in_schema(url, "installed_command").render_as_string(hide_password=False))
        setting_up = ("db", "upgrade", "0001", "--url", url, "--schema", "installed_command")
    else:
        place = ("--url", str(tmp_path / "store.db"))
        setting_up = ("db", "upgrade", "0001", *place)
    assert installed(*setting_up)[0] == 0
    code, _, refused = installed("load", str(mission.DOMAIN), *place)
    assert (code, "kbstore db upgrade" in refused) == (2, True)
    assert installed("db", "upgrade", *place)[::2] == (0, "")
    code, out, _ = installed("load", str(mission.DOMAIN), str(mission.PROBLEM), "--kb", "kenny", *place, "--json")
    assert (code, json.loads(out)["number"]) == (0, 1)
    assert installed("holds", "(robot_at kenny home)", *place) == (0, "true\n", "")
    assert installed("value", "(battery kenny)", *place) == (0, "62\n", "")


def test_the_demonstration_travels_with_the_wheel(installed, tmp_path):
    """`kbstore demo` needs no checkout."""
    code, out, err = installed("demo", str(tmp_path / "demo.db"))
    assert (code, err) == (0, "")
    assert "09:05:32.000000001" in out
