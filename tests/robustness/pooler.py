"""A pooler in transaction mode, as PgBouncer is: each transaction of a client runs on another server connection."""

import select
import socket
import struct
import threading
from contextlib import contextmanager, suppress

import sqlalchemy as sa

_SSL_REQUEST = 80877103
_GSS_REQUEST = 80877104
_IDLE = b"I"


class Server:
    """A connection to the server, which clients use in turn; where the startup answered is kept for them."""

    def __init__(self, address, startup):
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.connect(address)
        self.socket.sendall(startup)
        self.greeting = b""
        while True:
            kind, message = read(self.socket)
            assert kind != b"E", message
            self.greeting += message
            if kind == b"Z":
                break


def exactly(source, count):
    """So many bytes; an `EOFError` where there are no more."""
    data = b""
    while len(data) < count:
        more = source.recv(count - len(data))
        if not more:
            raise EOFError
        data += more
    return data


def read(source):
    """One message of the protocol: its type, and all of it."""
    kind = exactly(source, 1)
    length = exactly(source, 4)
    return kind, kind + length + exactly(source, struct.unpack("!I", length)[0] - 4)


class Pooler:
    """Listens on a port of this host.

    `transactions` counts those that were moved to another server connection, `trips` how often the server was waited
    for.
    """

    def __init__(self, address, count=2):
        self._address = address
        self._count = count
        self._servers = []
        self._lock = threading.Lock()
        self._turn = 0
        self.transactions = 0
        self.trips = 0
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self):
        with suppress(OSError):
            while True:
                client, _ = self._listener.accept()
                # rows are passed on one by one, and each would wait for the one before to be acknowledged
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client):
        with client, suppress(EOFError, OSError):
            while True:
                length = exactly(client, 4)
                startup = length + exactly(client, struct.unpack("!I", length)[0] - 4)
                if struct.unpack("!I", startup[4:8])[0] not in (_SSL_REQUEST, _GSS_REQUEST):
                    break
                client.sendall(b"N")
            with self._lock:
                if not self._servers:
                    self._servers = [Server(self._address, startup) for _ in range(self._count)]
            client.sendall(self._servers[0].greeting)
            while True:
                first = read(client)
                if first[0] == b"X":
                    return
                # one client at a time: what matters is on which connection its transactions are
                with self._lock:
                    self._turn += 1
                    self.transactions += 1
                    self._transaction(client, self._servers[self._turn % self._count].socket, first)

    def _transaction(self, client, server, message):
        """All that is said until the server is idle again; whoever leaves in the middle is rolled back."""
        # the server answers each query and each sync by being ready
        waiting = 0
        try:
            while True:
                kind, data = message
                if kind == b"X":
                    raise EOFError
                server.sendall(data)
                waiting += kind in (b"Q", b"S")
                while client not in (ready := select.select([client, server], (), ())[0]) or server in ready:
                    kind, data = read(server)
                    client.sendall(data)
                    waiting -= kind == b"Z"
                    self.trips += kind == b"Z"
                    if kind == b"Z" and not waiting and data[5:6] == _IDLE:
                        return
                message = read(client)
        except (EOFError, OSError):
            query = b"ROLLBACK\0"
            server.sendall(b"Q" + struct.pack("!I", len(query) + 4) + query)
            while waiting >= 0:
                waiting -= read(server)[0] == b"Z"
            raise

    @contextmanager
    def frozen(self):
        """Meanwhile nobody is answered."""
        with self._lock:
            yield

    def close(self):
        self._listener.close()
        for server in self._servers:
            server.socket.close()


@contextmanager
def pooled(url):
    """The URL of a database through a pooler, and the pooler; the server listens on a socket of the file system."""
    direct = sa.make_url(url)
    pooler = Pooler(f"{direct.query['host']}/.s.PGSQL.{direct.port or direct.query.get('port', 5432)}")
    through = direct.set(host="127.0.0.1", port=pooler.port).difference_update_query(("host", "port"))
    try:
        yield through.update_query_dict({"prepare_threshold": "none"}).render_as_string(hide_password=False), pooler
    finally:
        pooler.close()
