"""The page of a timeline: HTML, style, script and data in one text, which needs no network."""

import json
from functools import cache
from importlib.resources import files
from typing import Any

_ESCAPED = {ord(character): f"\\u{ord(character):04x}" for character in "<>&"}


def page(data: dict[str, Any]) -> str:
    """Return the page that shows the data of `kbstore.report.timeline.data.timeline_data`."""
    # the data come last, so that nothing in a name is substituted again
    return _template().replace("/*DATA*/", as_json(data), 1)


def as_json(data: dict[str, Any]) -> str:
    r"""Return JSON in ASCII that no name in it can end: it may be put into a script element.

    >>> as_json({"name": "</script>"})
    '{"name":"\\u003c/script\\u003e"}'
    """
    return json.dumps(data, separators=(",", ":")).translate(_ESCAPED)


@cache
def _template() -> str:
    """The page without its data."""
    html, css, js = (files(__package__).joinpath(f"page.{kind}").read_text("utf-8") for kind in ("html", "css", "js"))
    return html.replace("/*CSS*/", css.rstrip(), 1).replace("/*JS*/", js.rstrip(), 1)
