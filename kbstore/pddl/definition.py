"""The frame that domains and problems share: ``(define (kind name) (:section ...) ...)``."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from difflib import get_close_matches

from kbstore.names import problem as name_problem
from kbstore.pddl.scope import Scope
from kbstore.pddl.sexpr import Group, node_text

_ELSEWHERE = {
    ":axiom": "is PDDL 1.2; write a (:derived ...) rule",
    ":timeless": "is PDDL 1.2; write the facts into (:init ...)",
    ":extends": "is PDDL 1.2; write the whole domain into one file",
}


@dataclass(frozen=True)
class Definition:
    """One domain or problem: its name, its sections in order, and the whole."""

    name: str
    sections: tuple[Group, ...]
    whole: Group

    def all(self, keyword: str) -> Iterator[Group]:
        """The sections of a keyword."""
        return (section for section in self.sections if section.word(0) == keyword)

    def one(self, keyword: str) -> Group | None:
        """The section of a keyword that may occur once at most."""
        return next(self.all(keyword), None)


def read_definition(scope: Scope, kind: str, known: Collection[str], repeated: Collection[str]) -> Definition:
    """Read the definition of `kind` ("domain", "problem") that the text consists of.

    `known` are the keywords of its sections; those in `repeated` may occur several times. Raises `PddlSyntaxError`.
    """
    top = scope.source.read()
    forms = [index for index, form in enumerate(top) if not (isinstance(form, Group) and form.word(0) == "in-package")]
    if not forms:
        raise scope.error(f"the text is empty; a {kind} is (define ({kind} name) ...)", top)
    whole = top[forms[0]]
    if not isinstance(whole, Group) or whole.word(0) != "define":
        raise scope.error(f"a {kind} begins with (define ({kind} name) ...), not with this", top, forms[0])
    if len(forms) > 1:
        second = top[forms[1]]
        problem = "this is outside of the definition, which ended before: there is a ')' too many before"
        if isinstance(second, Group) and second.word(0) == "define":
            problem = "this is a second definition; give domain and problem as two files or texts"
        raise scope.error(problem, top, forms[1])
    header = whole[1] if len(whole) > 1 else None
    if not isinstance(header, Group) or len(header) != 2 or not isinstance(header[1], str):
        raise scope.error(f"(define ...) is followed by ({kind} name)", whole, 1)
    if header.word(0) != kind:
        raise scope.error(f"a {kind} is expected here, but this defines a {header.word(0)}", header, 0)
    return Definition(header[1], tuple(_sections(scope, whole, kind, known, repeated)), whole)


def check_name(scope: Scope, what: str, group: Group, index: int, name: str | None = None) -> str:
    """Return the word at a place, or `name`, which it contains. Raises `PddlSyntaxError` if it cannot name a `what`."""
    written = name if name is not None else scope.name(group, index, what)
    problem = name_problem(written)
    if problem:
        raise scope.error(f"the {what} name {written:.60} {problem}", group, index)
    return written


def _sections(
    scope: Scope, whole: Group, kind: str, known: Collection[str], repeated: Collection[str]
) -> Iterator[Group]:
    seen: dict[str, Group] = {}
    for index in range(2, len(whole)):
        section = whole[index]
        if not isinstance(section, Group) or not section.word(0).startswith(":"):
            raise scope.error(
                f"a section like ({sorted(known)[0]} ...) is expected here, not {node_text(section, 60)}", whole, index
            )
        keyword = section.word(0)
        if keyword not in known:
            raise scope.error(unknown_keyword(keyword, f"section of a {kind}", known), section, 0)
        if keyword not in repeated and keyword in seen:
            if node_text(section) != node_text(seen[keyword]):
                raise scope.error(f"the section {keyword} is here for the second time", section, 0)
            continue  # a repetition of the same section, as some generators write it
        seen[keyword] = section
        yield section


def unknown_keyword(keyword: str, what: str, known: Collection[str]) -> str:
    """Return the sentence that refuses an unknown keyword, and suggests the one that was meant."""
    if keyword in _ELSEWHERE:
        return f"{keyword} {_ELSEWHERE[keyword]}"
    close = get_close_matches(keyword[:40], known, 1)
    return f"{keyword:.40} is not a {what}" + (
        f"; did you mean {close[0]}?" if close else f"; there are {', '.join(known)}"
    )
