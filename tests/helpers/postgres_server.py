"""A PostgreSQL server of the tests' own."""

import os
import pwd
import shutil
import signal
import socket
import subprocess
import tempfile
import uuid
from pathlib import Path

import psutil
from sqlalchemy import create_engine, text

_USER = "truepath"


class PostgresServer:
    """Made by `initdb`, started at once, gone with its folder after `close`.

    password : asked for over TCP; without one, a socket in its folder is the only way

    Raises FileNotFoundError where PostgreSQL is not installed.
    """

    def __init__(self, password=""):
        self.password = password
        self._initdb, self._pg_ctl = _program("initdb"), _program("pg_ctl")
        self._user = pwd.getpwnam("postgres").pw_name if os.geteuid() == 0 else None
        self._folder = Path(tempfile.mkdtemp(prefix="pg"))
        if self._user:
            shutil.chown(self._folder, self._user)
        self._data = self._folder / "data"
        self._listens, login = "-c listen_addresses=", ("-A", "trust")
        self._place = f"/{{}}?host={self._folder}"
        if password:
            file = self._folder / "password"
            file.write_text(password)
            file.chmod(0o644)
            with socket.create_server(("127.0.0.1", 0)) as listener:
                host, port = listener.getsockname()
            self._listens, self._place = f"-h {host} -p {port}", f"{host}:{port}/{{}}"
            login = ("-A", "scram-sha-256", f"--pwfile={file}")
        self._run(self._initdb, "-D", self._data, *login, "-U", _USER, "-N")
        self.start()

    def start(self):
        options = f"-k {self._folder} {self._listens} -c fsync=off"
        self._control("-o", options, "-l", self._folder / "log", "start")

    def stop(self, mode="fast"):
        """Stop the server: `fast` ends its connections, `immediate` crashes it."""
        self._control("-m", mode, "stop")

    def freeze(self):
        self._signal(signal.SIGSTOP)

    def thaw(self):
        self._signal(signal.SIGCONT)

    def close(self):
        try:
            if (self._data / "postmaster.pid").exists():
                self.stop("immediate")
        finally:
            shutil.rmtree(self._folder, ignore_errors=True)

    def url(self, name="postgres"):
        return f"postgresql+psycopg://{_USER}@{self._place.format(name)}"

    def make_database(self, template="template1"):
        name = f"test_{uuid.uuid4().hex}"
        self._execute(f"CREATE DATABASE {name} TEMPLATE {template}")
        return name

    def drop_database(self, name):
        self._execute(f"DROP DATABASE {name} WITH (FORCE)")

    def _execute(self, query):
        engine = create_engine(self.url(), isolation_level="AUTOCOMMIT")
        try:
            with engine.connect() as connection:
                connection.execute(text(query))
        finally:
            engine.dispose()

    def _control(self, *options):
        self._run(self._pg_ctl, "-D", self._data, "-w", *options)

    def _run(self, *command):
        # Output of a server that goes on must not hold a pipe of ours.
        nowhere = dict.fromkeys(("stdout", "stderr"), subprocess.DEVNULL)
        how = {"user": self._user, "cwd": self._folder, "timeout": 60}
        subprocess.run(command, check=True, **how, **nowhere)

    def _signal(self, number):
        first = (self._data / "postmaster.pid").read_text().split()[0]
        main = psutil.Process(int(first))
        for process in (main, *main.children(recursive=True)):
            process.send_signal(number)


def _program(name):
    places = sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{name}"))
    found = shutil.which(name) or (places[-1] if places else None)
    if found is None:
        raise FileNotFoundError(f"{name} of PostgreSQL")
    return Path(found)
