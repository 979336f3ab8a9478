"""A pooler in transaction mode, like PgBouncer: each transaction of a client runs on another server connection."""

import select
import socket
import struct
import threading
from contextlib import contextmanager, suppress

import sqlalchemy as sa

_SSL_REQUEST = 80877103
_GSS_REQUEST = 80877104
_IDLE = b"I"
_PID = 1 << 30


class Server:
    """A connection to the server, which clients use in turn; the answers to its startup are kept for them."""

    def __init__(self, address, startup):
        self.startup = startup
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.connect(address)
        self.socket.sendall(startup)
        self.greeting = b""
        while True:
            kind, message = read(self.socket)
            assert kind != b"E", message
            if kind == b"K":
                # the session that clients believe to have; like PgBouncer, no number of the server's is passed on
                message = message[:5] + struct.pack("!I", _PID) + message[9:]
            self.greeting += message
            if kind == b"Z":
                break
        self._begun = b""

    def arrived(self):
        """The messages that have arrived completely, once there is one.

        Never waits for the rest of a message: the server sends a full buffer, and keeps the rest until the sync, which
        the client may not have sent yet.
        """
        more = self.socket.recv(1 << 16)
        if not more:
            raise EOFError
        data, at, messages = self._begun + more, 0, []
        while len(data) >= at + 5 and len(data) >= (end := at + 1 + struct.unpack_from("!I", data, at + 1)[0]):
            messages.append(data[at:end])
            at = end
        self._begun = data[at:]
        return messages


def exactly(source, count):
    """Exactly so many bytes; an `EOFError` where the stream ends before."""
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
                # forwarded data would wait for the acknowledgement of what was sent before
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
                # one client at a time: the tests are about which connection runs its transactions
                with self._lock:
                    self._turn += 1
                    self.transactions += 1
                    self._transaction(client, self._turn % self._count, first)

    def _transaction(self, client, place, message):
        """Forward all messages until the server is idle again.

        The server connection of a client that leaves in the middle is not used again.
        """
        server = self._servers[place]
        # the server answers each query and each sync by being ready
        waiting = 0
        try:
            while True:
                kind, data = message
                if kind == b"X":
                    raise EOFError
                server.socket.sendall(data)
                waiting += kind in (b"Q", b"S")
                while server.socket in select.select([client, server.socket], (), ())[0]:
                    messages = server.arrived()
                    ends = [message for message in messages if message[:1] == b"Z"]
                    waiting -= len(ends)
                    # before the client can look at it
                    self.trips += len(ends)
                    client.sendall(b"".join(messages))
                    if ends and not waiting and ends[-1][5:6] == _IDLE:
                        return
                message = read(client)
        except (EOFError, OSError):
            server.socket.close()
            self._servers[place] = Server(self._address, server.startup)
            raise

    @contextmanager
    def frozen(self):
        """Stop answering inside the block."""
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
