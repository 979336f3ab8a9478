"""Joins domain files: PlanSys2's parameter `model_file` may name several, separated by colons."""

from collections.abc import Sequence
from pathlib import Path

from kbstore.errors import PddlSyntaxError
from kbstore.pddl.sexpr import Group, Node, SourceText, node_text

_TYPED = (":types", ":constants")
_JOINED = (":requirements", *_TYPED, ":predicates", ":functions")


def joint_domain(model_file: str) -> str | Path:
    """Return the path of a single file; for several, the text of one domain with the sections of all.

    Its name joins the names of the domains. Raises `PddlSyntaxError` for a file that cannot be read, or that is not a
    domain.
    """
    paths = [Path(name) for name in model_file.split(":") if name]
    return paths[0] if len(paths) == 1 else _joined([SourceText.open(path) for path in paths])


def _joined(sources: Sequence[SourceText]) -> str:
    names: list[str] = []
    joined: dict[str, list[str]] = {keyword: [] for keyword in _JOINED}
    others: list[str] = []
    for source in sources:
        name, sections = _domain(source)
        names.append(name)
        for section in sections:
            keyword = section.word(0)
            if keyword not in joined:
                others.append(node_text(section))
                continue
            parts = list(section[1:])
            if keyword in _TYPED and parts and parts[-2:-1] != ["-"]:
                # otherwise untyped names at the end would get the type that follows in the next file
                parts += ["-", "object"]
            joined[keyword] += [
                text for text in map(node_text, parts) if keyword in _TYPED or text not in joined[keyword]
            ]
    texts = [f"({keyword} {' '.join(parts)})" for keyword, parts in joined.items() if parts]
    return "\n".join((f"(define (domain {'_'.join(names)})", *texts, *others, ")"))


def _domain(source: SourceText) -> tuple[str, list[Group]]:
    """Return the name and the sections of a domain."""
    found: list[Node] = list(source.read())
    whole = found[0] if len(found) == 1 else None
    head = whole[1] if isinstance(whole, Group) and whole.word(0) == "define" and len(whole) > 1 else None
    if not isinstance(whole, Group) or not isinstance(head, Group) or head.word(0) != "domain" or len(head) != 2:
        raise PddlSyntaxError("this is not a domain: (define (domain NAME) ...) is expected", source=source.name)
    return node_text(head[1]), [section for section in whole[2:] if isinstance(section, Group)]
