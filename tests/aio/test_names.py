"""kbstore.aio has what kbstore has: the same names, the same parameters."""

import inspect

import pytest

import kbstore
from kbstore import aio


def public(kind):
    return {name for name in dir(kind) if not name.startswith("_")}


def test_a_knowledge_base_has_the_same_names():
    """Every public name of `kbstore.KnowledgeBase` is there, and all others serve to call its functions."""
    names = public(kbstore.KnowledgeBase)
    assert public(aio.KnowledgeBase) - {"name", "use_unknowns"} == names | {"read", "write", "watched"}


def test_a_transaction_has_the_same_names():
    """`OpenTransaction` has them, too."""
    assert public(aio.OpenTransaction) - {"result"} == public(kbstore.OpenTransaction) | {"write"}


@pytest.mark.parametrize(
    ("awaited", "plain", "others"),
    [
        (aio.KnowledgeBase, kbstore.KnowledgeBase, {"transaction"}),
        (aio.OpenTransaction, kbstore.OpenTransaction, set()),
    ],
)
def test_methods_have_the_same_parameters_and_documentation(awaited, plain, others):
    """A method has the parameters and the text of the other's; a transaction takes no connection.

    Only `wait_for`, `close` and `is_quick` are written for asyncio, and say so.
    """
    for name in public(plain) - others:
        ours, theirs = getattr(awaited, name), getattr(plain, name)
        if inspect.isfunction(theirs):
            assert [*inspect.signature(ours).parameters.values()] == [*inspect.signature(theirs).parameters.values()]
            assert ours.__doc__ == theirs.__doc__ or name in ("wait_for", "close", "is_quick")
    assert inspect.signature(aio.open).parameters == inspect.signature(kbstore.open).parameters


def test_a_transaction_takes_all_but_a_connection():
    """A caller's connection belongs to the thread that uses it."""
    ours, theirs = (
        inspect.signature(kind.transaction).parameters for kind in (aio.KnowledgeBase, kbstore.KnowledgeBase)
    )
    assert set(theirs) - set(ours) == {"connection"}
    assert all(ours[name] == theirs[name] for name in ours)
