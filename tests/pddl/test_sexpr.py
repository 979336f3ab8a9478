"""S-expressions: groups, words, positions and brackets."""

import pytest

from kbstore.errors import PddlSyntaxError
from kbstore.pddl import sexpr
from kbstore.pddl.sexpr import Group, SourceText, node_text


def read(text):
    """A text as nested lists."""
    return SourceText(text).read()


class TestReading:
    def test_groups_and_words(self):
        """Brackets make groups; white space and brackets end words."""
        assert read("(a (b c)(d)) e") == [["a", ["b", "c"], ["d"]], "e"]

    def test_words_keep_their_case(self):
        """Words stay as written; only keywords are compared in lower case."""
        top = read("(At Kenny)")
        assert top[0][0] == "At"
        assert top[0].word(0) == "at"
        assert top[0].word(7) == ""

    @pytest.mark.parametrize("text", ["", "  \n\t", "; a comment only", ";;;"])
    def test_nothing(self, text):
        """A text of white space and comments is empty."""
        assert read(text) == []

    def test_comments(self):
        """A comment goes to the end of its line, brackets in it included."""
        assert read("(a ; (b (\n c) ; )\n(d);x") == [["a", "c"], ["d"]]

    @pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
    def test_line_ends(self, end):
        """Lines end as on Unix, Windows or old Macs, for comments and for positions."""
        source = SourceText(f"(a ; x{end} b{end} (c))")
        top = source.read()
        assert top == [["a", "b", ["c"]]]
        assert source.place(source.offset(top[0], 2)) == (3, 2)

    def test_deep(self):
        """100,000 levels are read and written without a deep stack."""
        depth = 100_000
        top = read("(" * depth + "a" + ")" * depth)
        assert node_text(top) == "(" * depth + "a" + ")" * depth

    def test_too_deep(self, monkeypatch):
        """Nesting that would fill the memory is refused."""
        monkeypatch.setattr(sexpr, "MAX_DEPTH", 1000)
        assert len(read("(" * 1000 + ")" * 1000)) == 1
        with pytest.raises(PddlSyntaxError, match="nested deeper"):
            read("(" * 1010 + ")" * 1010)

    def test_node_text(self):
        """A group's text has single spaces, and can be cut off."""
        group = read("( a\n(b   c) () )")[0]
        assert node_text(group) == "(a (b c) ())"
        assert node_text(group, 4) == "(a ( ..."


class TestPlaces:
    def test_children(self):
        """Each child of a group has its position, word or group; beyond the last there is the closing bracket."""
        source = SourceText("(aa (b) ; (x\n  cc)")
        group = source.read()[0]
        assert [source.place(source.offset(group, index)) for index in range(5)] == [
            (1, 2),
            (1, 5),
            (2, 3),
            (2, 5),
            (2, 5),
        ]
        assert source.place(source.offset(group)) == (1, 1)

    def test_whole_text(self):
        """The children of the whole text have positions, too."""
        source = SourceText("a (b)\nc")
        top = source.read()
        assert [source.place(source.offset(top, index)) for index in range(3)] == [(1, 1), (1, 3), (2, 1)]

    def test_diagnosis_of_a_long_line(self):
        """Of a long line the part around the position is quoted, with the mark under it."""
        source = SourceText("(" + "x" * 1000 + " here " + "y" * 1000 + ")")
        text = source.diagnosis("wrong", 1002)
        _, shown, mark = text.split("\n")
        assert text.startswith("line 1, column 1003: wrong")
        assert shown[mark.index("^") :].startswith("here")
        assert len(shown) < 120


class TestBrackets:
    def test_missing(self):
        """A bracket that is never closed is refused at its position."""
        with pytest.raises(PddlSyntaxError, match="never closed") as caught:
            read("(a)\n  (b (c)")
        assert (caught.value.line, caught.value.column) == (2, 3)

    def test_missing_at_the_end_of_a_section(self):
        """A section that swallowed the next one is the one that lacks its bracket."""
        with pytest.raises(PddlSyntaxError, match=r"not closed before the next one, \(:action on line 3") as caught:
            read("(define (domain d)\n  (:predicates (p)\n  (:action a)\n)")
        assert (caught.value.line, caught.value.column) == (2, 3)

    def test_extra(self):
        """A bracket that closes nothing is refused at its position, with its line."""
        with pytest.raises(PddlSyntaxError, match="closes nothing") as caught:
            read("(a)\n b)")
        assert (caught.value.line, caught.value.column) == (2, 3)
        assert "\n   b)\n    ^" in str(caught.value)


class TestOpening:
    def test_text(self):
        """A text with a bracket is PDDL text."""
        assert SourceText.open("(define)").name is None

    def test_path(self, tmp_path):
        """A text without one is a path; so is a path object, also of a file with a bracket in its name."""
        path = tmp_path / "a (1).pddl"
        path.write_text("(b)")
        for given in (path, str(path)):
            source = SourceText.open(given)
            assert (source.text, source.name) == ("(b)", str(path))

    @pytest.mark.parametrize("name", ["", "nowhere.pddl", "no text", "nul\0"])
    def test_missing_file(self, name, tmp_path, monkeypatch):
        """The refusal of an unreadable file names it, without a line."""
        monkeypatch.chdir(tmp_path)
        with pytest.raises(PddlSyntaxError, match=r"^cannot read the file"):
            SourceText.open(name)

    @pytest.mark.parametrize("given", [None, 7, b"(p)", ["(p)"]])
    def test_neither(self, given):
        """An argument that is neither text nor a path is refused."""
        with pytest.raises(PddlSyntaxError, match=r"^give the path"):
            SourceText.open(given)

    def test_encodings(self, tmp_path):
        """UTF-8 with a byte order mark and Latin-1 are both read."""
        path = tmp_path / "x.pddl"
        path.write_bytes("\ufeff(ü)".encode())
        assert SourceText.open(path).read() == SourceText.open("\ufeff(ü)").read() == [["ü"]]
        path.write_bytes("(ü)".encode("latin-1"))
        assert SourceText.open(path).read() == [["ü"]]

    def test_group_is_a_list(self):
        """A group compares as the list of its parts."""
        assert read("(a)")[0] == ["a"]
        assert isinstance(read("(a)")[0], Group)
