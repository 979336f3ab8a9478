"""Errors: their messages can be printed, with any text that they quote."""

import re

import pytest

import kbstore

RAW = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u202e\ud800-\udfff]")


@pytest.mark.parametrize("nasty", ["\x1b[31m", "\x00", "\x07", "\x9b", "\u202e", "\ud800", "\r"])
def test_no_message_carries_raw_control_characters(nasty):
    """Text from a client cannot colour, rewind or break a terminal or a log through an error."""
    with kbstore.open("sqlite://") as kb:
        kb.load("(define (domain d) (:types t) (:predicates (p ?x - t)))")
        wrong = [
            lambda: kb.add(f"(p a{nasty}b)"),
            lambda: kb.add(f"(q{nasty})"),
            lambda: kb.add(kbstore.Fact(attribute_name=f"p{nasty}", values=["a"])),
            lambda: kb.add(kbstore.Fact(attribute_name="p", values=[f"a{nasty}"])),
            lambda: kb.add({"knowledge_type": 1, f"x{nasty}": 1}),
            lambda: kb.holds(f"(and (p a) {nasty}"),
            lambda: kb.holds("(p a)", at=f"yesterday{nasty}"),
            lambda: kb.apply(f"go{nasty}"),
        ]
        for call in wrong:
            with pytest.raises(kbstore.KbStoreError) as caught:
                call()
            assert not RAW.search(str(caught.value))
            assert not any(RAW.search(violation) for violation in getattr(caught.value, "violations", ()))


@pytest.mark.parametrize("breaking", ["a\nb", "a\n  - b", "a\r\nb"])
def test_quoted_text_adds_no_line_to_a_message(breaking):
    """A name in a message cannot add a line to an error, not even one that looks like the error's own."""
    with kbstore.open("sqlite://") as kb:
        kb.load("(define (domain d) (:types t) (:predicates (p ?x - t) (q)) (:functions (f)))")
        wrong = [
            lambda: kb.add(kbstore.Fact(attribute_name=breaking)),
            lambda: kb.add(kbstore.Fact(attribute_name="q", values=[breaking])),
            lambda: kb.add(kbstore.Function(attribute_name=breaking, function_value=1)),
            lambda: kb.add(kbstore.Instance(instance_name="x", instance_type=breaking)),
            lambda: kb.holds(kbstore.Fact(attribute_name=breaking)),
            lambda: kb.remove(kbstore.Fact(attribute_name="p", values=[breaking, "a"])),
            lambda: kb.instances(breaking),
            lambda: kb.apply(breaking),
            lambda: kb.set_sensed(breaking, True),
            lambda: kb.domain.function(breaking),
            lambda: kbstore.open(f"sqlite:////nowhere/{breaking}.db", read_only=True),
        ]
        for call in wrong:
            with pytest.raises(kbstore.KbStoreError) as caught:
                call()
            assert "\n" not in str(caught.value)


def test_every_error_keeps_the_text_and_the_builtin_that_it_had():
    """An error has its sentence, and a builtin base class for callers who know only Python."""
    for error, builtin in (
        (kbstore.StoreUnavailable, ConnectionError),
        (kbstore.UnknownSymbol, LookupError),
        (kbstore.InvalidKnowledge, ValueError),
        (kbstore.DivisionByZero, ZeroDivisionError),
    ):
        assert issubclass(error, builtin)
        assert str(error("one\n  two\tthree é 部屋")) == "one\n  two\tthree é 部屋"
