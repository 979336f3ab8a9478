"""Tools for agents: ``mcp``."""

from contextlib import AbstractContextManager
from typing import Annotated

import typer

from kbstore.cli.options import Kb, Now, Url, reading, writing
from kbstore.errors import MissingLibrary
from kbstore.knowledge_base import KnowledgeBase


def mcp(
    allow_writes: Annotated[
        bool, typer.Option("--allow-writes", help="Offer also the tools add and remove; otherwise it only reads.")
    ] = False,
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
) -> None:
    """Offer a knowledge base to an agent, as tools by the Model Context Protocol on standard input and output.

    An agent's program starts this command. Its name is the client of what it writes. Needs the extra mcp.

    Examples:
        kbstore mcp --url robot.db --kb kenny
        kbstore mcp --url robot.db --kb kenny --allow-writes
    """
    try:
        from kbstore.serve.mcp import agent_server
    except ImportError as error:
        raise MissingLibrary(
            f"the tools for agents need the library mcp, which cannot be imported ({error});"
            " install it with: pip install 'kbstore[mcp]'"
        ) from None
    opened: AbstractContextManager[KnowledgeBase] = (
        writing(url, kb, now, creating=False) if allow_writes else reading(url, kb, now)
    )
    with opened as found:
        agent_server(found, allow_writes=allow_writes).run("stdio")
