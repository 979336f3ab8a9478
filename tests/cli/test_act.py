"""Actions from the command line: applied, started, ended, aborted (rules O1 to O3, O7)."""

import pytest

import kbstore
from kbstore.cli.demo import mission

NINE = "2026-05-04T09:00:00Z"


@pytest.fixture
def ward(run, tmp_path):
    """Run commands a number of seconds after nine, when the problem of the demonstration was loaded."""
    url = tmp_path / "ward.db"
    loaded = run("load", mission.DOMAIN, mission.PROBLEM, "--url", url, "--kb", "kenny", "--now", NINE)
    assert loaded.code == 0

    def running(*arguments, after=0):
        now = str(kbstore.time(NINE) + kbstore.seconds(after))
        return run(*arguments, "--url", url, "--now", now)

    return running


def test_apply_has_all_effects(ward):
    """O3: an instantaneous action is one transaction."""
    done = ward("apply", "pick_up", "kenny", "blood", "home")
    assert (done.code, "(parcel_at blood home) is false" in done.err) == (2, True)
    ward("add", "(parcel_at blood home)")
    assert ward("apply", "pick_up", "kenny", "blood", "home", after=1).out.startswith("transaction 3 at ")
    assert ward("holds", "(carries kenny blood)", after=2).code == 0


def test_start_and_end(ward):
    """O3: the domain fixes the duration of undocking; it is ended by its name, as it is the only run."""
    started = ward("start", "undock", "kenny", "home", "--client", "mission")
    assert started.out == (
        "transaction 2 at 2026-05-04T09:00:00Z: (undock kenny home) started, "
        "its end is expected at 2026-05-04T09:00:10Z\n"
    )
    assert ward("holds", "(undocked kenny)", after=1).code == 1
    ended = ward("end", "UNDOCK", after=11)
    assert ended.out == "transaction 3 at 2026-05-04T09:00:11Z: (undock kenny home) ended\n"
    assert ward("holds", "(undocked kenny)", after=12).code == 0
    again = ward("end", "undock", after=13)
    assert (again.code, again.err) == (2, "kbstore: (undock) is not running; see kbstore state\n")


def test_a_duration_is_given_with_units(ward):
    """O3, O7: charging takes as long as given, up to ten minutes; 30 alone has no unit."""
    assert "--duration 30s" in ward("start", "charge", "kenny").err
    assert "is not a duration; write it with units" in ward("start", "charge", "kenny", "--duration", "30").err
    assert "600" in ward("start", "charge", "kenny", "--duration", "11m").err
    report = ward("start", "charge", "kenny", "--duration", "1m30s", "--json").json
    assert (report["run"]["duration_ns"], report["transaction"]["number"]) == (90 * 10**9, 2)
    # 62 percent and half a percent a second
    assert ward("value", "(battery kenny)", after=20).out == "72\n"
    aborted = ward("abort", "charge", "kenny", "--note", "called away", after=20)
    assert aborted.out == "transaction 3 at 2026-05-04T09:00:20Z: (charge kenny) aborted\n"
    assert ward("value", "(battery kenny)", after=60).out == "72\n"


def test_a_duration_can_be_forced(ward):
    """O7: --force overrules the constraint, and the answer names it."""
    done = ward("start", "charge", "kenny", "--duration", "11m", "--force")
    assert done.code == 0
    assert "; forced against (<= ?duration 600)" in done.out


def test_arguments_select_one_of_several_runs(ward):
    """The arguments select one; without them two runs are ambiguous."""
    ward("add", "bob - robot", "(docked bob)", "(= (battery bob) 10)")
    ward("start", "charge", "kenny", "--duration", "1m", after=1)
    ward("start", "charge", "bob", "--duration", "1m", after=2)
    assert ward("end", "charge", after=3).err == (
        "kbstore: which charge? (charge kenny), (charge bob) are running; give the arguments\n"
    )
    assert ward("end", "charge", "bob", after=4).code == 0
    assert ward("end", "charge", after=5).code == 0


def test_an_unknown_operator_is_named(ward):
    """V8: by each of the four commands."""
    for command in ("apply", "start", "end", "abort"):
        done = ward(command, "fly", "kenny")
        assert (done.code, "no operator fly" in done.err) == (2, True)


def test_acting_creates_no_store(run, tmp_path):
    """A mistyped store is refused, and not created."""
    for command in ("apply", "start", "end", "abort"):
        done = run(command, "fly", "--url", tmp_path / "typo.db")
        assert (done.code, "there is no store at" in done.err) == (2, True)
    assert list(tmp_path.iterdir()) == []


def test_end_reports_broken_invariants(ward):
    """O6: the door is shut for two seconds while kenny passes; the action has ended all the same."""
    ward("start", "undock", "kenny", "home")
    ward("end", "undock", after=10)
    ward("add", "(robot_at kenny corridor)", "(open lab_door)", after=10)
    ward("start", "pass_door", "kenny", "lab_door", "corridor", "lab", after=11)
    ward("remove", "(open lab_door)", after=20)
    ward("add", "(open lab_door)", after=22)
    done = ward("end", "pass_door", after=51)
    assert done.out.splitlines()[1:] == [
        "over all, (open lab_door) is false since 2026-05-04T09:00:20Z until 2026-05-04T09:00:22Z"
    ]
    ended = ward("runs", "pass_door", "--json", after=60).json
    assert [(broken["since"], broken["until"]) for broken in ended[0]["broken"]] == [
        ("2026-05-04T09:00:20Z", "2026-05-04T09:00:22Z")
    ]


def test_runs_lists_runs(run):
    """Q8: on the mission of the demonstration; as of a time, a run that ended later is running."""
    words = run("runs").words
    assert words[0] == "Times of 2026-05-04, UTC"
    assert words[3] == "(undock kenny home) 08:58:10 08:58:20 08:58:20 10 s ended"
    assert "(pass_door kenny lab_door corridor lab) 09:00:40 09:01:20 09:01:02 22 s aborted" in words
    # the alarm shut the door two seconds before the action was aborted
    assert words[-1] == (
        "(pass_door kenny lab_door corridor lab): (open lab_door) was false from 09:01:00 until 09:01:02"
    )
    (found,) = run("runs", "(drive kenny corridor ?)", "--json").json
    assert (found["ended"], found["ended_by"], found["outcome"]) == ("2026-05-04T09:06:48Z", 21, "ended")
    (found,) = run("runs", "drive", "--as-of", "2026-05-04T08:58:30Z", "--json").json
    assert (found["ended"], found["outcome"]) == (None, "running")
    assert run("runs", "--until", "2026-05-04T08:58:00Z").out == "nothing ran in that span\n"
    assert "no operator fly" in run("runs", "fly").err
