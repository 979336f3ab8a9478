"""Commands that change a knowledge base, and their output."""

import pytest

import kbstore

DOMAIN = """; (define (problem of-reading-comments)
(define (domain trolleys)
  (:types trolley place)
  (:predicates (parked ?t - trolley ?p - place))
  (:functions (load ?t - trolley)))
"""
PROBLEM = """
(define (problem evening) (:domain trolleys)
  (:objects t1 - trolley yard shed - place)
  (:init (parked t1 yard) (= (load t1) 5) (at 60 (not (parked t1 yard))))
  (:goal (parked t1 shed)))
"""
NOON = "2026-05-04T12:00:00Z"


@pytest.fixture
def files(tmp_path):
    """A domain, a problem, and a store with both loaded at noon."""
    domain, problem = tmp_path / "domain.pddl", tmp_path / "problem.pddl"
    domain.write_text(DOMAIN)
    problem.write_text(PROBLEM)
    return domain, problem


@pytest.fixture
def trolleys(run, files, tmp_path):
    """Run commands at one second after noon, in a store where the files were loaded at noon."""
    url = tmp_path / "trolleys.db"
    # the domain, three objects, two timelines of the state, a goal
    loaded = run("load", *files, "--url", url, "--kb", "yard", "--now", NOON, "--client", "office", "--note", "evening")
    assert (loaded.code, loaded.out) == (0, f"transaction 1 at {NOON}: 7 changes\n")

    def running(*arguments, now="2026-05-04T12:00:01Z"):
        return run(*arguments, "--url", url, "--now", now)

    running.url = url
    return running


def test_load_takes_domain_and_problem_in_any_order(run, files, tmp_path):
    """The contents decide which file is which; timed-initial literals are relative to now (P3)."""
    domain, problem = files
    done = run("load", problem, domain, "--url", tmp_path / "new.db", "--now", NOON, "--json")
    assert (done.code, done.json["number"], done.json["time"]) == (0, 1, NOON)
    with kbstore.open(tmp_path / "new.db", "default") as kb:
        (scheduled,) = kb.timed_knowledge(at=NOON)
        assert scheduled.initial_time == kbstore.time(NOON) + kbstore.seconds(60)


def test_a_problem_alone_uses_the_loaded_domain(trolleys, files):
    """Loading a problem again changes only its timed knowledge; --replace clears first."""
    again = trolleys("load", files[1], "--replace", "--note", "anew", "--json").json
    assert (again["number"], again["note"]) == (2, "anew")
    assert trolleys("holds", "(parked t1 yard)").code == 0


def test_load_once(trolleys, files):
    """P7: a loaded problem is not loaded again, even after changes: for scripts that start a service."""
    assert trolleys("load", *files, "--once").out == "nothing changed; the latest transaction is 1\n"
    trolleys("remove", "t1")
    assert trolleys("load", *files, "--once").out == "nothing changed; the latest transaction is 2\n"


def test_load_refuses_two_domains_and_three_files(trolleys, files):
    """Two domains are refused; so is a third file."""
    domain, problem = files
    assert "are domains; load one" in trolleys("load", domain, domain).err
    assert "are problems; load one" in trolleys("load", problem, problem, domain).err


def test_add_and_remove(trolleys):
    """Objects, facts of both signs, values; an update that changes nothing takes no number (C1, C4)."""
    added = trolleys("add", "t2 - trolley", "(parked t2 shed)", "(increase (load t1) 2)", "--client", "yardman")
    assert (added.code, added.out) == (0, "transaction 2 at 2026-05-04T12:00:01Z: 3 changes\n")
    assert trolleys("value", "(load t1)").out == "7\n"
    assert trolleys("add", "(parked t2 shed)").out == "nothing changed; the latest transaction is 2\n"
    assert trolleys("remove", "(parked ? shed)", "--note", "swept").out.endswith(": 1 change\n")
    assert trolleys("holds", "(parked t2 ?)").code == 1
    assert "#3 at 2026-05-04T12:00:01Z swept" in trolleys("changes", "--after", 2).words


def test_at_schedules_and_cancels(trolleys):
    """--at schedules, and removing with exactly that time cancels (T4, C5)."""
    trolleys("add", "(parked t1 shed)", "--at", "+30s")
    at = "2026-05-04T12:00:31Z"
    assert trolleys("holds", "(parked t1 shed)", "--at", at).code == 0
    assert trolleys("remove", "(parked t1 shed)", "--at", at).out.endswith(": 1 change\n")
    assert trolleys("holds", "(parked t1 shed)", "--at", at).code == 1


def test_goals(trolleys):
    """A conjunction is split; ? removes all matches (C10)."""
    trolleys("goal", "add", "(and (parked t1 yard) (>= (load t1) 8))")
    goals = [goal["pddl"] for goal in trolleys("state", "--json").json["goals"]]
    assert sorted(goals) == ["(>= (load t1) 8)", "(parked t1 shed)", "(parked t1 yard)"]
    trolleys("goal", "remove", "(parked t1 ?)")
    assert [goal["pddl"] for goal in trolleys("state", "--json").json["goals"]] == ["(>= (load t1) 8)"]


def test_the_metric_is_shown_set_and_removed(trolleys):
    """Without an argument it is shown (C11)."""
    assert trolleys("metric").out == "there is no metric\n"
    assert trolleys("metric", "minimize (load t1)").code == 0
    assert trolleys("metric").out == "minimize (load t1)\n"
    assert trolleys("metric", "--json").json["item"]["optimization"] == "minimize"
    trolleys("metric", "--remove")
    assert trolleys("metric", "--json").json is None


def test_the_knowledge_base_is_the_only_one_or_named(trolleys, run, files):
    """With one knowledge base in the store it need not be named; with two it must."""
    assert trolleys("holds", "(parked t1 yard)").code == 0
    trolleys("load", files[0], "--kb", "other")
    unnamed = trolleys("holds", "(parked t1 yard)")
    assert unnamed.code == 2
    assert "it has other, yard; name one with --kb" in unnamed.err
    assert run("--url", trolleys.url, "--kb", "yard", "holds", "(parked t1 yard)", "--at", NOON).code == 0


def test_the_environment_names_store_and_knowledge_base(trolleys, monkeypatch, run, files):
    """KBSTORE_URL and KBSTORE_KB are used where there is no option; an option before or after the command wins."""
    trolleys("load", files[0], "--kb", "other")
    monkeypatch.setenv("KBSTORE_URL", str(trolleys.url))
    monkeypatch.setenv("KBSTORE_KB", "yard")
    assert run("holds", "(parked t1 yard)", "--at", NOON).code == 0
    assert run("holds", "(parked t1 yard)", "--at", NOON, "--kb", "other").code == 1
    assert run("--kb", "other", "holds", "(parked t1 yard)", "--at", NOON).code == 1
    assert run("--kb", "nobody", "holds", "(parked t1 yard)", "--at", NOON, "--kb", "yard").code == 0
