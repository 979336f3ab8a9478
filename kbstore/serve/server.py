"""The server: uvicorn, which ends streams before it waits for connections."""

import socket
from collections.abc import Callable

import uvicorn
from fastapi import FastAPI

from kbstore.errors import StoreUnavailable


def listen(host: str, port: int) -> socket.socket:
    """Return a socket that listens; port 0 takes a free one. Raises `StoreUnavailable` if the address is not free."""
    try:
        return socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except OSError as error:
        raise StoreUnavailable(f"cannot listen at {host}, port {port} ({error.strerror}); give others") from None


class Server(uvicorn.Server):
    """A server for an application of `kbstore.serve.web.make_app`; `ready` is called with its address."""

    def __init__(self, app: FastAPI, *, ready: Callable[[str], None] = lambda _: None) -> None:
        # the time is for streams and connections that do not end by themselves
        super().__init__(uvicorn.Config(app, log_level="warning", server_header=False, timeout_graceful_shutdown=5))
        self._store = app.state.store
        self._ready = ready

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to answer, and report the addresses."""
        await super().startup(sockets)
        for each in sockets or ():
            host, port = each.getsockname()[:2]
            self._ready(f"http://{f'[{host}]' if ':' in host else host}:{port}/")

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End the streams, and then the rest."""
        self._store.stop()
        await super().shutdown(sockets)
