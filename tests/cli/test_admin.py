"""Whole knowledge bases: listing, exporting, importing, copying, archiving."""

import json

import kbstore
from kbstore.transfer.push import Push

ALARM = "2026-05-04T09:02:00Z"


def test_kbs_lists_what_a_store_has(run):
    """The names, the domain, and the time of the latest transaction."""
    done = run("kbs", "--now", "2026-05-04T09:19:10Z")
    assert done.words[2:] == ["kenny deliveries closed 2026-05-04T09:09:10Z 10 min ago 7 13"]
    (kb,) = run("kbs", "--json").json
    assert (kb["name"], kb["last_time"], kb["objects"]) == ("kenny", "2026-05-04T09:09:10Z", 7)


def test_export_writes_the_problem_as_of_a_time(run, tmp_path):
    """PDDL that reads back to the same state (P2)."""
    text = run("export", "--at", ALARM).out
    assert "(robot_at kenny corridor)" in text
    assert "(at 480 (not (open lab_door)))" in text
    file = tmp_path / "problem.pddl"
    assert run("export", "--at", ALARM, "--output", file).out == f"{file}: {len(text):,} bytes\n"
    assert file.read_text() == text
    (tmp_path / "domain.pddl").write_text(run("export", "--domain").out)
    with kbstore.open("sqlite://") as kb:
        kb.load(tmp_path / "domain.pddl", file)
        assert kb.value("(battery kenny)") == 35.5


def test_export_in_json_at_a_time_is_the_state(run):
    """The same as `state --json`."""
    assert run("export", "--format", "json", "--at", ALARM).json == run("state", "--at", ALARM, "--json").json


def test_export_and_import_restore_everything(run, tmp_path):
    """A whole knowledge base as JSON Lines, under another name in another store: the same history."""
    lines, other = tmp_path / "kenny.jsonl", tmp_path / "other.db"
    assert run("export", "--format", "json", "--output", lines).code == 0
    done = run("import", lines, "--url", other, "--kb", "ken")
    assert done.out == f"ken was restored from {lines}\n"
    assert run("history", "(open lab_door)", "--url", other).out == run("history", "(open lab_door)").out
    assert run("state", "--at", ALARM, "--as-of", "2026-05-04T09:00:45Z", "--url", other, "--json").json["facts"]
    again = run("import", lines, "--url", other, "--kb", "ken")
    assert (again.code, again.out) == (2, "")
    assert "has a knowledge base 'ken'" in again.err


def test_export_to_standard_output(run, tmp_path):
    """Without --output the lines can be piped."""
    file = tmp_path / "piped.jsonl"
    run("export", "--format", "json", "--output", file)
    assert run("export", "--format", "json").out == file.read_text()


def test_backup_makes_a_store(run, tmp_path):
    """A copy that can be asked, and is not overwritten."""
    copy = tmp_path / "copy.db"
    done = run("backup", copy)
    assert done.out == f"{copy}: {copy.stat().st_size:,} bytes\n"
    assert run("value", "(battery kenny)", "--at", ALARM, "--url", copy).out == "35.5\n"
    assert run("backup", copy).code == 2


def test_archive_moves_history_out(run, store, tmp_path):
    """Earlier history is in the archive, and questions about it are refused by the store (Q7)."""
    archive = tmp_path / "old.db"
    done = run("archive", "--before", "2026-05-04T09:05:00Z", archive, "--url", store, "--json")
    assert (done.code, done.json["history_from"]) == (0, "2026-05-04T09:05:00Z")
    assert run("value", "(battery kenny)", "--at", ALARM, "--url", archive).out == "35.5\n"
    refused = run("value", "(battery kenny)", "--at", ALARM, "--url", store)
    assert (refused.code, "has been archived" in refused.err) == (2, True)
    assert "(= (battery kenny) 25.5)" in run("history", "(battery kenny)", "--url", store).words[3]
    again = run("archive", "--before", "2026-05-04T08:00:00Z", archive, "--url", store)
    assert again.code == 0
    assert again.out.startswith("there was nothing to archive")


def test_demo_makes_a_file(run, tmp_path):
    """The demonstration from the command line, with the path in JSON on request."""
    file = tmp_path / "demo.db"
    done = run("demo", file, "--json").json
    assert (done["file"], done["name"], done["last_time"]) == (str(file), "kenny", "2026-05-04T09:09:10Z")
    assert run("demo", file).code == 2


def test_push_continues_a_knowledge_base_elsewhere(run, store, tmp_path):
    """Everything arrives once; the copy is read-only until it is adopted."""
    fleet = tmp_path / "fleet.db"
    push = ("push", "--url", store, "--to", fleet)
    assert run(*push).out == "kenny is there up to transaction 25: 25 transactions pushed\n"
    assert run("add", "(open lab_door)", "--url", store).code == 0
    # the transaction, its recorded end, and the new one
    assert run(*push, "--json").json == {"name": "kenny", "number": 26, "transactions": 1, "rows": 3}
    asked = ("history", "(open lab_door)", "--url")
    assert run(*asked, fleet).out == run(*asked, store).out
    refused = run("remove", "(open lab_door)", "--url", fleet)
    assert refused.code == 2
    assert f"kenny in sqlite:///{store}" in refused.err
    assert run("db", "adopt", "--url", fleet).out.startswith("kenny is written to here from now on; it was a copy of")
    assert run("remove", "(open lab_door)", "--url", fleet).code == 0
    again = run(*push)
    assert (again.code, again.out) == (2, "")
    assert "it is at transaction 27" in again.err
    assert run(*push, "--as", "ken").out == "ken is there up to transaction 26: 26 transactions pushed\n"


def test_push_follows(run, store, tmp_path, monkeypatch):
    """With --follow there is a line for each push; Ctrl-C ends it."""
    fleet, seen = tmp_path / "fleet.db", []

    def look(push):
        seen.append(1)
        if len(seen) == 2:
            with kbstore.open(store, "kenny") as kb:
                kb.add("(open lab_door)")
        if len(seen) == 4:
            raise KeyboardInterrupt
        return original(push)

    original = Push._latest
    monkeypatch.setattr(Push, "_latest", look)
    done = run("push", "--url", store, "--to", fleet, "--follow", "--json")
    assert done.code == 130
    lines = [json.loads(line) for line in done.out.splitlines()]
    assert lines == [{"name": "kenny", "number": number, "latest": number} for number in (25, 26)]
