"""Writes docs/reference.md from the docstrings of the public interface: ``python docs/reference.py``."""

import enum
import inspect
import re
from functools import cached_property
from pathlib import Path
from typing import Annotated, get_args, get_origin

import kbstore
from kbstore.evaluation.intervals import Intervals

PAGE = Path(__file__).with_name("reference.md")

GROUPS = {
    "Opening": ("open", "knowledge_bases", "KnowledgeBase", "OpenTransaction"),
    "What is asked, and answered": (
        "State",
        "Transaction",
        "Assertion",
        "Assertions",
        "Change",
        "Diff",
        "Explanation",
        "Applicability",
        "Run",
        "QueryResult",
        "Truth",
        "Intervals",
    ),
    "Knowledge": (
        "item",
        "Knowledge",
        "Question",
        "Instance",
        "Fact",
        "Function",
        "Expression",
        "Inequality",
        "Condition",
        "KnowledgeItem",
    ),
    "The domain": ("Domain", "DomainFormula", "DomainAssignment", "DomainOperator", "DomainInequality"),
    "Parts of messages": ("ExprComposite", "ExprBase", "KeyValue"),
    "Keeping": ("backup", "export_knowledge_base", "import_knowledge_base", "Archived", "Ingested"),
    "Time": ("seconds", "time", "TimeLike", "DurationLike", "Clock", "SystemClock", "ManualClock"),
}
"""The names that have a place of their own; the others are sorted into the groups below."""

MORE, ENUMS, ERRORS = "More", "Numbers of the messages", "Errors"

NOT_EXPORTED = {"Intervals": Intervals}
"""What answers are made of that has no name in `kbstore` itself."""

SHARED = {"trusted", "changed"}
"""What every message has for kbstore's own use."""

_SECTION = re.compile(r"^(Args|Attributes|Returns|Raises|Yields):$")
_ENTRY = re.compile(r"^    (\w[\w, ]*): (.*)$")


def page():
    """The whole page."""
    parts = [
        "# Reference",
        "Everything that `import kbstore` gives, from the docstrings (`python docs/reference.py` writes this page)."
        " Times that are taken are anything of rule T2 in [the semantics](semantics.md); times that are given are"
        " nanoseconds.",
    ]
    for title, names in groups().items():
        parts.append(f"## {title}")
        for name in names:
            parts += entry(name, NOT_EXPORTED.get(name) or getattr(kbstore, name))
    return "\n\n".join(parts) + "\n"


def groups():
    """All public names, by group."""
    found = {title: list(names) for title, names in GROUPS.items()}
    placed = {name for names in found.values() for name in names}
    rest = {MORE: [], ENUMS: [], ERRORS: []}
    for name in sorted(set(kbstore.__all__) - placed):
        thing = getattr(kbstore, name)
        kind = MORE
        if inspect.isclass(thing):
            kind = ERRORS if issubclass(thing, Exception) else ENUMS if issubclass(thing, enum.Enum) else MORE
        rest[kind].append(name)
    rest[ERRORS].sort(key=lambda name: (name != "KbStoreError", name))
    return found | {title: names for title, names in rest.items() if names}


def entry(name, thing):
    """One public name: its heading, its signature, what it is, and its members."""
    yield f"### {name}"
    if not inspect.isclass(thing):
        if inspect.isfunction(thing):
            yield f"`{signature(f'kbstore.{name}', thing)}`"
            yield from described(thing)
        else:
            yield "One of " + ", ".join(f"`{name}`" for name in member_names(thing)) + "."
        return
    yield from described(thing)
    if issubclass(thing, enum.Enum):
        yield ", ".join(f"`{member.name}` {member.value}" for member in thing)
        return
    fields = list(getattr(thing, "model_fields", None) or getattr(thing, "__dataclass_fields__", ()))
    if fields:
        yield "Fields: " + ", ".join(f"`{field}`" for field in fields) + "."
    if issubclass(thing, Exception):
        return
    for member, value in members_of(thing):
        if isinstance(value, property):
            yield f"- `{member}`: {first_lines(value)}"
        else:
            yield f"- `{signature(member, value)}`\n\n" + indented("\n\n".join(described(value)))


def member_names(union):
    """The names of what a union is made of; what is of the model, which has no page, is named as a whole."""
    union = get_args(union)[0] if get_origin(union) is Annotated else union
    names = {}
    for member in get_args(union):
        if get_origin(member) is Annotated:
            names["KnowledgeItem"] = True
        elif getattr(member, "__module__", "").startswith("kbstore.model") or get_origin(member) is tuple:
            names["kbstore.model.formulas.Formula"] = True
        else:
            names[getattr(get_origin(member) or member, "__name__", str(member))] = True
    return list(names)


def members_of(thing):
    """The public methods and properties of a class, its own and those of kbstore's bases, in the order of writing."""
    found = {}
    for base in reversed(thing.__mro__):
        if base.__module__.startswith("kbstore"):
            for name, value in vars(base).items():
                if name.startswith(("_", "model_")) or name in SHARED:
                    continue
                member = value.__func__ if isinstance(value, classmethod | staticmethod) else value
                if isinstance(member, cached_property):
                    member = property(member.func)
                if isinstance(member, property) or inspect.isfunction(member):
                    found[name] = member
    return list(found.items())


def signature(name, function):
    """The name with its parameters, without types and without self."""
    parameters = []
    starred = False
    for parameter in inspect.signature(function).parameters.values():
        if parameter.name in ("self", "cls"):
            continue
        if parameter.kind is parameter.KEYWORD_ONLY and not starred:
            parameters.append("*")
            starred = True
        stars = {parameter.VAR_POSITIONAL: "*", parameter.VAR_KEYWORD: "**"}
        text = stars.get(parameter.kind, "") + parameter.name
        starred = starred or parameter.kind is parameter.VAR_POSITIONAL
        if parameter.default is not parameter.empty:
            text += f"={parameter.default!r}"
        parameters.append(text)
    return f"{name}({', '.join(parameters)})"


def described(thing):
    """The docstring as Markdown: sections become lists."""
    text = inspect.getdoc(thing) or ""
    for paragraph in re.split(r"\n\n+", text):
        lines = paragraph.split("\n")
        section = _SECTION.match(lines[0])
        if section:
            yield f"{section[1]}:"
            yield listed(lines[1:])
        elif lines[0].startswith(">>>"):
            yield "```text\n" + paragraph + "\n```"
        else:
            yield paragraph.replace("``", "`")


def listed(lines):
    """The entries of a section as a list, each on one line."""
    entries = []
    for line in lines:
        found = _ENTRY.match(line)
        if found:
            entries.append(f"- `{found[1]}`: {found[2]}")
        elif entries:
            entries[-1] += f" {line.strip()}"
        else:
            entries.append(f"- {line.strip()}")
    return "\n".join(entries).replace("``", "`")


def first_lines(value):
    """A property's docstring on one line."""
    return " ".join((inspect.getdoc(value) or "").split()).replace("``", "`")


def indented(text):
    """Text that belongs to an item of a list."""
    return "\n".join(f"  {line}" if line else "" for line in text.split("\n"))


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
