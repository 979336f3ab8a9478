"""The page of a timeline as text: its content, and its safety against names."""

import json
import re

import pytest

from kbstore.cli.demo.mission import moment, record
from kbstore.clock import seconds
from kbstore.report.timeline.page import as_json, page
from tests.project.conftest import ROOT

HOSTILE = ("</script><script>alert(1)</script>", "<!--", "&lt;", "\u2028\u2029", "/*JS*/", "]]>", "\ud800")


@pytest.fixture(scope="module")
def kenny():
    with record("sqlite://") as kb:
        yield kb


def test_json_does_not_end_the_script():
    """Names are escaped, and are the same when read again."""
    text = as_json({"names": HOSTILE})
    assert re.fullmatch(r"[ -~]*", text)
    assert not set("<>&") & set(text)
    assert tuple(json.loads(text)["names"]) == HOSTILE


def test_a_page_has_its_data_once():
    """The data are where the page reads them, with any content."""
    text = page({"name": "/*DATA*/ /*CSS*/ </script>"})
    assert text.count("/*DATA*/ /*CSS*/") == 1
    assert text.count("</script>") == 2
    (data,) = re.findall(r'<script id="data" type="application/json">(.*?)</script>', text)
    assert json.loads(data) == {"name": "/*DATA*/ /*CSS*/ </script>"}


def test_a_page_refers_to_nothing_elsewhere():
    """It has no addresses but those of its own parts, and its policy allows no connection."""
    text = page({})
    assert not re.findall(r"https?:|//\w+\.|url\(|@import|\bimport\b|fetch\(|XMLHttp|EventSource", text)
    assert "default-src 'none'" in text
    assert "connect-src" not in text


def test_the_script_is_short():
    """At most 500 lines, without a build step."""
    assert len((ROOT / "kbstore/report/timeline/page.js").read_text("utf-8").splitlines()) <= 500


def test_timeline_writes_the_page_that_it_returns(kenny, tmp_path):
    """`kb.timeline` takes times like any question (rule T2), and writes to the given file."""
    path = tmp_path / "kenny.html"
    text = kenny.timeline(
        path, patterns=["battery"], since="2026-05-04T09:00:00Z", until=moment("09:05:00"), as_of="-1m"
    )
    assert path.read_text("utf-8") == text
    data = json.loads(re.search(r'type="application/json">(.*?)</script>', text)[1])
    assert (data["origin"], data["until"]) == (str(moment("09:00:00")), seconds(300))
    assert data["as_of"] == 24
    assert len(text) < 100_000
