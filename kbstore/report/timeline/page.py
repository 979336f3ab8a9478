"""Makes the page of a timeline: HTML, style, script and data in one text, which needs no network."""

import json
from functools import cache
from importlib.resources import files
from typing import Any

_ESCAPED = {ord(character): f"\\u{ord(character):04x}" for character in "<>&"}


def page(data: dict[str, Any]) -> str:
    """Return the page that shows the data of `kbstore.report.timeline.data.timeline_data`.

    If the data have a `stream`, an address, the page is live: it listens to events of the types data, patch and now.
    """
    # the data come last, so that nothing in a name is substituted again
    return _template("stream" in data).replace("/*DATA*/", as_json(data), 1)


def as_json(data: dict[str, Any]) -> str:
    r"""Return JSON in ASCII that may be put into a script element, which no name in it can end.

    >>> as_json({"name": "</script>"})
    '{"name":"\\u003c/script\\u003e"}'
    """
    return json.dumps(data, separators=(",", ":")).translate(_ESCAPED)


@cache
def _template(is_live: bool) -> str:
    """Return the page without its data; a live one has the script that follows the stream."""
    html, css, js = (_part(f"page.{kind}") for kind in ("html", "css", "js"))
    if is_live:
        html = html.replace("img-src data:", "img-src data:; connect-src 'self'", 1)
        js = f"{js}\n{_part('live.js')}"
    return html.replace("/*CSS*/", css, 1).replace("/*JS*/", js, 1)


def _part(name: str) -> str:
    return files(__package__).joinpath(name).read_text("utf-8").rstrip()
