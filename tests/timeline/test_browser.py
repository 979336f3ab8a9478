"""The page of a timeline in a real browser: its content, its controls, and its safety."""

import os
import time
from itertools import pairwise
from pathlib import Path

import pytest

import kbstore
from kbstore import seconds
from kbstore.cli.demo.mission import moment, record
from kbstore.clock import ManualClock
from kbstore.report.timeline.data import timeline_data
from kbstore.report.timeline.page import page
from tests.timeline.worlds import START, pairs, values_of, world

SECOND = 10**9


@pytest.fixture(scope="module")
def kenny():
    with record("sqlite://") as kb:
        yield kb


@pytest.fixture
def shown(browser, kenny):
    """The page of the demonstration; at the end there were no errors, and no other requests."""
    browser.errors()
    browser.requested()
    yield browser.open(kenny.timeline())
    assert browser.errors() == []
    assert {address.partition(":")[0] for address in browser.requested()} <= {"file", "data", "about"}


def after(text):
    """A time of the mission, as the page counts."""
    return moment(text) - moment("08:58:00")


@pytest.mark.parametrize("seed", [None, 1, 2, 3, 4])
def test_the_page_shows_the_state(browser, kenny, seed):
    """Q2, O3: at 200 random cursors, as of random transactions, facts and numbers are those of the state."""
    kb = kenny if seed is None else world(seed)
    data = timeline_data(kb, expectations=10**6)
    browser.open(page(data))
    asked = list(pairs(kb, data, 200, seed))
    cursors = [[t - int(data["origin"]), data["latest"] + 1 if tx is None else tx.number] for t, tx in asked]
    found = browser.run(
        """
        const kinds = ["number", "goal", "object"];
        return arguments[0].map(([t, n]) => [kbstore.facts(t, n), ...kinds.map((kind) => kbstore.state(t, n, kind))]);
        """,
        cursors,
    )
    for (t, tx), (facts, numbers, goals, objects) in zip(asked, found, strict=True):
        state = kb.state(t, as_of=tx)
        values = sorted((text[3 : text.index(")") + 1], float(text[text.index(")") + 2 : -1])) for text in numbers)
        assert (facts, values) == values_of(state), (t, tx)
        assert goals == sorted(map(str, state.goals)), (t, tx)
        assert objects == sorted(map(str, state.instances)), (t, tx)


def test_the_state_is_shown_beside_the_lanes(shown):
    """At the cursor, with runs; with `as_of` the expected state."""
    shown.jump(after("09:02:00"), 26)
    assert "2026-05-04 09:02:00 UTC" in shown.text("#at")
    assert {"(not (open lab_door))", "(robot_at kenny corridor)"} <= set(shown.text("#state").splitlines())
    shown.jump(after("09:02:00"), 10)
    assert {"(open lab_door)", "(robot_at kenny lab)", "(= (battery kenny) 31)"} <= set(
        shown.text("#state").splitlines()
    )
    assert "#10 at 09:00:40 by mission: start (pass_door" in shown.text("#asofText")


def test_the_slider_moves_the_belief(shown):
    """The slider's end is the latest knowledge, and each step before is a transaction."""
    slider = "const slider = document.querySelector('#asof');"
    assert shown.run(f"{slider} return [slider.min, slider.max, slider.value]") == ["0", "26", "26"]
    shown.run(f"{slider} slider.value = 7; slider.dispatchEvent(new Event('input'))")
    shown.settle()
    assert "by ward: the patient was moved" in shown.text("#asofText")
    shown.press("[")
    assert "#6" in shown.text("#asofText")


def test_a_search_leaves_the_lanes_that_match(shown):
    """Every word has to be in the lane's name; Escape shows all again."""
    everything = len(shown.run("return kbstore.places()"))
    shown.run(
        "const box = document.querySelector('#search'); box.value = 'Kenny lab'; box.dispatchEvent(new Event('input'))"
    )
    shown.settle()
    assert [each["text"] for each in shown.run("return kbstore.places()")] == [
        "actions",
        "(pass_door kenny lab_door corridor lab)",
        "(pass_door kenny lab_door lab corridor)",
        "robot_at",
        "(robot_at kenny lab)",
    ]
    shown.press("Escape")
    assert len(shown.run("return kbstore.places()")) == everything


def test_groups_fold(shown):
    """A click on a group's name folds it, another unfolds it."""
    before = [each["text"] for each in shown.run("return kbstore.places()")]
    shown.click(None, "robot_at")
    folded = [each["text"] for each in shown.run("return kbstore.places()")]
    assert set(before) - set(folded) == {f"(robot_at kenny {p})" for p in ("home", "office", "corridor", "lab")}
    shown.click(None, "robot_at")
    assert [each["text"] for each in shown.run("return kbstore.places()")] == before


def test_a_click_explains(shown):
    """Who recorded it, when and why it ended: for a fact, a cancelled schedule, an action, a transaction."""
    shown.click(after("09:02:00"), "(open lab_door)")
    assert shown.text("#explain").splitlines()[::2] == [
        "(not (open lab_door))",
        "from 09:01:00 until 09:04:00, for 3 min 0 s",
        "recorded by #11 at 09:01:00 by fire alarm: all doors closed",
        "ended by #14 at 09:04:00 by facilities: all clear; the lab stays open until 09:15 instead",
    ]
    shown.click(after("09:10:05"), "(open lab_door)")
    text = shown.text("#explain")
    assert "10 min 0 s ahead" not in text
    assert "recorded by #1 at 08:58:00 by mission" in text
    assert "cancelled by #14" in text
    shown.click(after("09:00:50"), "(pass_door kenny lab_door corridor lab)")
    text = shown.text("#explain")
    assert "aborted: from 09:00:40, for 22 s (expected: 40 s)" in text
    assert "invariant broken: (open lab_door), from 09:01:00 until 09:01:02" in text
    shown.click_transaction(after("08:59:10"))
    assert shown.text("#explain") == "#7 at 08:59:10 by ward: the patient was moved; no linen today"


def test_lanes_are_drawn(shown):
    """True is solid, explicitly false in another colour, scheduled is hatched, absent is empty."""
    ground, cursor = shown.colours(after("08:58:30"), "(open lab_door)", 1)[0], after("09:09:10")
    (true,), (false,) = (set(shown.colours(after(t), "(open lab_door)", 20)) for t in ("09:05:00", "09:02:00"))
    assert len({ground, true, false}) == 3
    scheduled = shown.colours(after("09:00:05"), "(open lab_door)", 30)
    assert sum(one != other for one, other in pairwise(scheduled)) > 8
    assert shown.colours(cursor, "(robot_at kenny home)")[0] not in (true, ground)


def test_a_link_carries_the_view(shown, kenny):
    """Cursor, belief and span are in the address, and a page that is opened with them shows the same."""
    shown.jump(after("09:02:00"), 10)
    shown.press("+")
    for _ in range(50):
        view = shown.run("return location.hash")
        if "as_of=10" in view and f"t={moment('09:02:00')}" in view:
            break
        time.sleep(0.05)
    state = shown.text("#state")
    shown.jump(0, 1)
    shown.open(kenny.timeline(), view)
    assert (shown.text("#at"), shown.text("#state")) == ("2026-05-04 09:02:00 UTC", state)


def test_keys(shown):
    """Comma and dot go to the transactions, `u` changes between UTC and local time, `a` folds all."""
    shown.jump(after("09:01:00"), 26)
    shown.press(",")
    assert "09:00:40" in shown.text("#at")
    shown.press(".")
    shown.press(".")
    assert "09:01:02" in shown.text("#at")
    shown.press("u")
    assert "local" in shown.text("#at")
    shown.press("a")
    assert "(robot_at kenny home)" not in [each["text"] for each in shown.run("return kbstore.places()")]


def test_hostile_names_are_text(browser):
    """Names, clients and notes with markup in them are shown as text, and have no effect."""
    nasty = "<img src=x onerror=alert(1)></script><script>document.title='gone'</script>"
    with kbstore.open("sqlite://", nasty, clock=ManualClock(START)) as kb:
        kb.add("(p a)", client=nasty, note=f"{nasty}\u2028<!--")
        kb.add("(<b>bold</b> <i>x</i> &amp)")
        kb.add_goal("(<u>g</u>)")
        browser.errors()
        browser.open(kb.timeline())
    assert browser.text("#name") == nasty
    assert browser.run("return document.title") == f"{nasty} - timeline"
    assert "(<b>bold</b> <i>x</i> &amp)" in browser.text("#state")
    browser.click_transaction(0)
    assert nasty in browser.text("#asofText") + browser.text("#explain")
    assert browser.run("return document.querySelectorAll('img, b, i:not(.bar), u, script').length") == 2
    assert browser.errors() == []


def test_an_empty_page(browser):
    """The page of an empty knowledge base has no errors."""
    with kbstore.open("sqlite://", "empty", clock=ManualClock(START)) as kb:
        browser.errors()
        browser.open(kb.timeline())
    assert browser.text("#state") == "Nothing holds."
    assert browser.errors() == []


def many(assertions=50_000, lanes=700):
    """An hour of a busy robot: lanes of facts and numbers that change again and again."""
    count, hour = assertions // lanes, 3600 * SECOND
    step = hour // count
    described = [[lane % 20, f"o{lane}", [f"o{lane}"]] for lane in range(lanes)]
    groups = [["number" if group < 5 else "fact", f"symbol{group}"] for group in range(20)]
    rows, transactions = [], []
    for turn in range(count):
        transactions.append([turn + 1, turn * step, "robot", f"turn {turn}"])
        for lane in range(lanes):
            end, ended = ((turn + 1) * step, turn + 2) if turn + 1 < count else (None, 0)
            value, rate = (float(turn % 9), 0.5) if lane % 20 < 5 else ((turn + lane) % 3 > 0, 0)
            rows.append([lane, turn * step, end, turn + 1, 0, ended, 0, int(value) if rate == 0 else value, rate])
    return {
        "name": "busy", "closed": True, "origin": str(seconds(1000)), "until": hour, "now": hour, "base": 0,
        "latest": count, "as_of": None, "known_from": 1, "transactions": transactions, "groups": groups,
        "lanes": described, "rows": rows, "runs": [], "expected": [], "reached": [],
    }  # fmt: skip


def test_fifty_thousand_assertions(browser, capsys):
    """The page of an hour with 50,000 assertions works; the times of drawing and of moving the cursor are printed."""
    text = page(many())
    browser.errors()
    begin = time.perf_counter()
    browser.open(text)
    browser.settle()
    first = time.perf_counter() - begin
    moving = """
        const took = Array.from({ length: 40 }, (_, index) => {
          const begin = performance.now();
          kbstore.jump(index * 6e10 + 7, arguments[0] ? 30 + index : 72);
          document.body.offsetHeight;
          return performance.now() - begin;
        }).sort((a, b) => a - b);
        return `${Math.round(took[20])} ms, at most ${Math.round(took[39])} ms`;
    """
    cursor, belief = browser.run(moving, False), browser.run(moving, True)
    browser.press("a")
    browser.press("a")
    unfolded = browser.run(moving, False)
    with capsys.disabled():
        print(f"\n{len(text) / 1e6:.1f} MB; first picture {first:.2f} s; a move of the cursor {cursor}; of cursor and")
        print(f"belief {belief}; of the cursor with all lanes unfolded {unfolded}")
    assert len(browser.run("return kbstore.facts(1e12, 72)")) == 525
    assert browser.errors() == []


def test_all_lanes_are_on_paper(shown):
    """In print, also from a dark screen, all lanes have their full height, dark on white, without controls."""
    screen = shown.run("return document.querySelector('canvas').clientHeight")
    shown.run("document.querySelector('#fold').click(); document.querySelector('#fold').click()")
    shown.emulate(prefers_color_scheme="dark")
    shown.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    shown.settle()
    try:
        height = shown.run("return document.querySelector('canvas').clientHeight")
        last = shown.run("return kbstore.places().at(-1)")
        assert screen < last["y"] + last["height"] <= height
        assert shown.run("return getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
        assert shown.run("return document.querySelector('#asof').offsetParent") is None
    finally:
        shown.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
    shown.settle()
    assert shown.run("return document.querySelector('canvas').clientHeight") == screen


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_picture(shown, scheme, tmp_path):
    """The README's picture is made here where KBSTORE_TEST_PICTURE names a file, and is below 200 kB."""
    shown.emulate(prefers_color_scheme=scheme)
    shown.jump(after("09:02:00"), 26)
    shown.click(after("09:02:00"), "(open lab_door)")
    picture = Path(os.environ.get("KBSTORE_TEST_PICTURE", tmp_path / "timeline.png"))
    picture = picture.with_stem(f"{picture.stem}{'' if scheme == 'light' else '-dark'}")
    assert shown.driver.save_screenshot(str(picture))
    assert 20_000 < picture.stat().st_size < 200_000
