"""The schema of a store from the command line."""

import pytest

from kbstore.storage.schema import HEAD


def test_current_check_and_history(run):
    """The schema of a current store, and the list of revisions."""
    assert run("db", "current").out == f"schema {HEAD}; this kbstore needs {HEAD}\n"
    assert run("db", "current", "--json").json == {"revision": HEAD, "needed": HEAD}
    assert run("db", "check").out == f"ready: schema {HEAD}\n"
    assert [revision["number"] for revision in run("db", "history", "--json").json][-1] == HEAD


def test_an_old_store_is_refused_and_upgraded(run, store):
    """Downgraded, refused with the command to run, upgraded again with the copy named, and the same answers."""
    before = run("history", "(open lab_door)", "--url", store).out
    down = run("db", "downgrade", "0001", "--url", store, "--json").json
    assert (down["before"], down["after"]) == (HEAD, "0001")
    refused = run("state", "--url", store)
    assert refused.code == 2
    assert f"kbstore db upgrade --url sqlite:///{store}" in refused.err
    assert run("db", "check", "--wait", "0.1", "--url", store).code == 2
    up = run("db", "upgrade", "--url", store)
    assert up.out.startswith(f"schema 0001 was changed to {HEAD}; the store as it was before is in {store}.0001.")
    assert run("history", "(open lab_door)", "--url", store).out == before
    assert run("db", "upgrade", "--url", store).out == f"schema {HEAD}, unchanged\n"


def test_no_backup(run, store):
    """With --no-backup there is no copy."""
    assert run("db", "downgrade", "0001", "--no-backup", "--url", store, "--json").json["copy"] is None


def test_a_store_is_set_up(run, tmp_path):
    """A new file gets its schema; a question does not create a missing one."""
    new = tmp_path / "new.db"
    assert run("db", "current", "--url", new).code == 2
    assert not new.exists()
    assert run("db", "upgrade", "--url", new).out == f"schema {HEAD} was created\n"
    assert run("kbs", "--url", new).out == "there is no knowledge base yet\n"


@pytest.mark.parametrize("revision", ["9999", "nonsense"])
def test_an_unknown_revision_is_refused(run, store, revision):
    """A revision that does not exist changes nothing."""
    done = run("db", "upgrade", revision, "--url", store)
    assert (done.code, done.err.count("\n")) == (2, 1)


def test_a_schema_in_postgresql(run, postgresql_url):
    """--schema names kbstore's schema, beside others' tables."""
    place = ("--url", postgresql_url, "--schema", "cli_test")
    assert run("db", "upgrade", *place, "--json").json["after"] == HEAD
    assert run("db", "current", *place, "--json").json["revision"] == HEAD
    assert run("db", "downgrade", "base", *place, "--json").json["after"] is None
