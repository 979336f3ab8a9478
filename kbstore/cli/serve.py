"""The web service: ``serve``."""

import os
from typing import Annotated

import typer

import kbstore
from kbstore.cli.options import Now, Url, clock_for, store
from kbstore.errors import MissingLibrary

TOKEN = "KBSTORE_TOKEN"


def serve(
    host: Annotated[
        str, typer.Option("--host", metavar="ADDRESS", help="Where to listen; others reach what is not this machine.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option("--port", help="The port; 0 takes a free one.", min=0, max=65535)] = 8011,
    token: Annotated[
        str | None,
        typer.Option(
            "--token",
            metavar="TOKEN",
            help=f"What requests have to give; better by the environment, as others see arguments. [{TOKEN}]",
            show_default=False,
        ),
    ] = None,
    allow_writes: Annotated[
        bool, typer.Option("--allow-writes", help="Take changes, too; otherwise it only reads.")
    ] = False,
    allow_origin: Annotated[
        list[str] | None,
        typer.Option(
            "--allow-origin", metavar="ORIGIN", help="Let pages of this site ask. Repeatable.", show_default=False
        ),
    ] = None,
    patience: Annotated[
        float, typer.Option("--patience", metavar="SECONDS", help="How long an answer may take.", min=0.1)
    ] = 10,
    most: Annotated[int, typer.Option("--most", metavar="MB", help="How large an answer may be.", min=1)] = 50,
    url: Url = None,
    now: Now = None,
) -> None:
    """Serve the store on the web, until Ctrl-C: a live timeline for people, and questions in JSON for programs.

    It serves all knowledge bases of the store, on this machine only. Another address needs a token. Needs the extra
    web.

    Examples:
        kbstore serve --url robot.db
        kbstore serve --url robot.db --allow-writes --port 9000
        kbstore serve --url robot.db --host 0.0.0.0
    """
    try:
        from kbstore.serve.server import Server, listen
        from kbstore.serve.store import Store
        from kbstore.serve.web import make_app
    except ImportError as error:
        raise MissingLibrary(
            f"the web service needs the libraries fastapi and uvicorn, which cannot be imported ({error});"
            " install them with: pip install 'kbstore[web]'"
        ) from None
    place = store(url)
    # a store that cannot be opened is an error now, and not at the first request
    kbstore.knowledge_bases(place)
    served = Store(
        place,
        allow_writes=allow_writes,
        clock=lambda name: clock_for(place, name, now),
        patience=patience,
        most=most * 1_000_000,
    )
    app = make_app(
        served,
        host=host,
        token=token if token is not None else os.environ.get(TOKEN) or None,
        allow_writes=allow_writes,
        allow_origins=allow_origin or (),
    )
    server = Server(app, ready=lambda address: typer.echo(f"{place} is served at {address}", err=True))
    server.run([listen(host, port)])
