"""Every block of Python and of a shell in the documentation is run."""

import re

import pytest

from tests.docs.blocks import DATA, DOCUMENTS, ROOT, RUN, Reader, blocks, same_text, shown

POSTGRESQL = "postgresql+psycopg://robots@localhost/fleet"
"""The server of the documentation's reader; here, that of the tests."""


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_block_runs(document, tmp_path, monkeypatch, request):
    """Blocks run in order, print the documented output, and succeed."""
    monkeypatch.chdir(tmp_path)
    replacing = {}
    if any(POSTGRESQL in block.text for block in blocks(document)):
        replacing[POSTGRESQL] = request.getfixturevalue("empty_database")
    reader = Reader(tmp_path, replacing)
    for block in blocks(document):
        assert block.language in RUN | DATA, f"{document}:{block.line}: say which language this is"
        try:
            printed = reader.run(block)
        except BaseException as error:
            raise AssertionError(f"{document}:{block.line}: {error}") from error
        promised = shown(block) if block.language in RUN else None
        assert promised is None or same_text(printed, promised), f"{document}:{block.line} printed:\n{printed}"


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_link_leads_somewhere(document):
    """Links within the project are to existing files, and to headings in them."""
    text = re.sub(r"^```.*?^```$", "", document.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, heading = target.partition("#")
        file = (document.parent / path).resolve() if path else document
        assert file.exists(), f"{document}: {target}"
        if heading:
            headings = re.findall(r"^#+ (.*)$", file.read_text(encoding="utf-8"), re.MULTILINE)
            assert heading in [_anchor(title) for title in headings], f"{document}: {target}"


def _anchor(title):
    return re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")


def test_a_wrong_output_is_noticed(tmp_path, monkeypatch):
    """The runner itself: a block with another output, or a command that fails, fails."""
    monkeypatch.chdir(tmp_path)
    document = tmp_path / "wrong.md"
    for text in ("```python\nprint(1)  # 2\n```", "```sh\nkbstore nonsense\n```", "```sh\nfalse | true && false\n```"):
        document.write_text(text + "\n")
        with pytest.raises(AssertionError):
            Reader(tmp_path).run(blocks(document)[0])
    assert not same_text("one\ntwo\n", "one\nthree\n")
    assert same_text("one\ntwo  2\nthree\n", "one\n...\nthree\n")
