"""The live page in a real browser: new transactions arrive, and the cursor follows."""

import time

import pytest

import kbstore
from kbstore.cli.demo.mission import record
from tests.serve.test_server import running

NASTY = "<img src=x onerror=alert(1)></script><script>document.title='gone'</script>"


@pytest.fixture
def store(tmp_path):
    with kbstore.open(tmp_path / "k.db", "kenny") as kb:
        kb.add("(lit hall)", "(lit attic)", "(= (battery) 80)", "(map a b)", client="setup")
        kb.remove("(lit attic)")
    return tmp_path / "k.db"


@pytest.fixture
def live(browser, store):
    """The page, and its knowledge base; at the end there were no errors, and no other requests."""
    browser.errors()
    browser.requested()
    with kbstore.open(store, "kenny") as kb, running(store) as address:
        browser.visit(address)
        yield browser, kb
        assert browser.errors() == []
        asked = {each for each in browser.requested() if not each.startswith(("data:", "about:", "chrome:"))}
        assert {each.split("/")[2] for each in asked} == {address.split("/")[2]}
        browser.visit("about:blank")


def eventually(is_so):
    """Wait until a condition is true, within some seconds."""
    for _ in range(200):
        if is_so():
            return True
        time.sleep(0.05)
    return False


def test_new_transactions_arrive(live):
    """New lanes, ends, transactions: without a reload, and the slider stays at the latest knowledge."""
    page, kb = live
    assert eventually(lambda: page.text("#connection") == "live")
    kb.add("(lit cellar)", client="somebody", note="a new lamp")
    kb.remove("(lit hall)")
    assert eventually(lambda: "(lit cellar)" in page.text("#state") and "(lit hall)" not in page.text("#state"))
    assert page.run("const s = document.querySelector('#asof'); return [s.max, s.value]") == ["5", "5"]
    assert "(lit cellar)" in [each["text"] for each in page.run("return kbstore.places()")]
    kb.add("(= (battery) 40)")
    assert eventually(lambda: "(= (battery) 40)" in page.text("#state"))


def test_the_cursor_follows_now_until_it_is_moved(live):
    """After a click it stays; the button lets it follow again."""
    page, kb = live
    first = page.text("#at")
    assert eventually(lambda: page.text("#at") > first)
    assert page.run("return document.querySelector('#follow').getAttribute('aria-pressed')") == "true"
    page.click(page.run("return (view[0] + view[1]) / 2"), "(lit hall)")
    assert page.run("return document.querySelector('#follow').getAttribute('aria-pressed')") == "false"
    moved = page.text("#at")
    kb.remove("(lit hall)")
    assert eventually(lambda: page.run("return document.querySelector('#asof').max") == "4")
    assert page.text("#at") == moved
    assert "(lit hall)" in page.text("#state")
    page.run("document.querySelector('#follow').click()")
    assert eventually(lambda: page.text("#at") > moved and "(lit hall)" not in page.text("#state"))


def test_a_recording_of_another_day_is_not_left(browser, tmp_path):
    """The page shows the last time of the recording; the button leads to now."""
    record(f"sqlite:///{tmp_path / 'k.db'}").close()
    with running(tmp_path / "k.db") as address:
        browser.visit(address)
        assert eventually(lambda: browser.text("#connection") == "live")
        assert browser.run("return document.querySelector('#follow').getAttribute('aria-pressed')") == "false"
        assert browser.text("#at").startswith("2026-05-04 09:")
        browser.visit("about:blank")


def test_a_selected_belief_stays_selected(live):
    """New transactions are to the right of it."""
    page, kb = live
    page.jump(10**9, 1)
    kb.add("(lit cellar)")
    assert eventually(lambda: page.run("return document.querySelector('#asof').max") == "4")
    assert page.run("return document.querySelector('#asof').value") == "1"
    assert "(lit cellar)" not in page.text("#state")


def test_folded_groups_stay_folded(live):
    """New transactions unfold no group; a group of constant facts with a change is no longer one."""
    page, kb = live

    def lanes():
        return {each["text"] for each in page.run("return kbstore.places()")}

    page.click(None, "lit")
    assert "(map a b)" not in lanes()
    kb.add("(lit cellar)", "(map b c)")
    assert eventually(lambda: "(lit cellar)" in page.text("#state"))
    assert lanes() & {"(lit hall)", "(lit cellar)", "(map a b)"} == {"(map a b)"}


def test_hostile_names_that_arrive_are_text(live):
    """As on the first page: they are shown as text, and have no effect."""
    page, kb = live
    kb.add("(<b>bold</b> <i>x</i> &amp)", client=NASTY, note=NASTY)
    assert eventually(lambda: "(<b>bold</b> <i>x</i> &amp)" in page.text("#state"))
    page.jump(0, 3)
    assert NASTY in page.text("#asofText")
    assert page.run("return document.title") == "kenny - timeline"
    assert page.run("return document.querySelectorAll('img, b, i:not(.bar)').length") == 0


def test_a_list_of_hostile_names_is_text(browser, tmp_path):
    """Several knowledge bases are listed, each with a link to its page."""
    for name in (NASTY, "a/b?c&d"):
        kbstore.open(tmp_path / "k.db", name).close()
    browser.errors()
    with running(tmp_path / "k.db") as address:
        browser.visit(address)
        assert browser.text("ul").splitlines() == [NASTY, "a/b?c&d"]
        assert browser.run("return document.querySelectorAll('img, script').length") == 0
        for number, name in enumerate((NASTY, "a/b?c&d")):
            browser.visit(address)
            browser.run("document.querySelectorAll('a')[arguments[0]].click()", number)
            shown = "return document.querySelector('#name')?.innerText"
            assert eventually(lambda name=name, shown=shown: browser.run(shown) == name)
        browser.visit("about:blank")
    assert browser.errors() == []


def test_the_page_reconnects_to_a_restarted_server(browser, store):
    """The page shows that the connection is lost."""
    with running(store) as address:
        browser.visit(address)
        assert eventually(lambda: browser.text("#connection") == "live")
    assert eventually(lambda: browser.text("#connection") == "connecting again")
    browser.visit("about:blank")
    # the failed connection is on the console
    browser.errors()
