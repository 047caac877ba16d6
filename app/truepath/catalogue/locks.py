"""Locks of one service: on its data folder, and on a catalogue in PostgreSQL.

The lock of a catalogue belongs to a separate connection: a server that restarts
releases it, and it is taken again as soon as the server is back. A measurement
continues meanwhile.
"""

from __future__ import annotations

import fcntl
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import structlog
from sqlalchemy import Connection, Engine, text
from sqlalchemy.exc import SQLAlchemyError

from truepath.catalogue.database import Database
from truepath.catalogue.errors import InUse, StorageUnavailable
from truepath.errors import BadInput
from truepath.log_throttle import LogThrottle
from truepath_drivers import host_clock

_AWAY = frozenset({"nfs", "nfs4", "cifs", "smb3", "smbfs", "9p", "fuse.sshfs", "afs"})
MOUNTS = Path("/proc/mounts")


@contextmanager
def hold_folder(folder: Path, mounts: Path = MOUNTS) -> Iterator[None]:
    """Make the data folder and lock it for this process. Raises BadInput, InUse."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / ".lock").open("w")
    except OSError as error:
        raise BadInput(f"setting data_dir: {folder}: {error.strerror}") from error
    with lock:
        kind = find_file_system(folder.resolve(), mounts)
        if kind is not None and is_network_share(kind):
            raise BadInput(
                f"setting data_dir: {folder} is on a share of the network ({kind}), "
                "where a Run can be damaged; give a disk of this computer"
            )
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise InUse(
                f"another instance works on {folder}; stop it, or give another data_dir"
            ) from error
        yield


def find_file_system(place: Path, mounts: Path = MOUNTS) -> str | None:
    """Kind of file system of an absolute path; None where unknown.

    mounts : as Linux lists them
    """
    try:
        rows = [line.split()[1:3] for line in mounts.read_text().splitlines()]
    except OSError:
        return None
    above = [row for row in rows if place.is_relative_to(row[0].replace("\\040", " "))]
    return max(above, key=lambda row: len(row[0]))[1] if above else None


def is_network_share(kind: str) -> bool:
    """Whether a kind of file system is on another computer.

    A Run is a SQLite file with a write-ahead log, which needs memory that several
    processes share: no network share has that.
    """
    return kind in _AWAY


log = structlog.get_logger(__name__)

PATIENCE_S = 5.0
"""How long the connection of a service that was killed may take to be gone."""
_LOOK_EVERY_S = 5.0
# A computer that lost its power closes no connection: after a minute it counts as gone.
_KEEP_ALIVE = text(
    "SET tcp_keepalives_idle = 30; SET tcp_keepalives_interval = 10; "
    "SET tcp_keepalives_count = 3"
)
# Of one database; of one schema, for installations with a catalogue in each of several.
_TAKE = text(
    "SELECT pg_try_advisory_lock(hashtext('truepath'), hashtext(current_schema()))"
)


@contextmanager
def hold_catalogue(
    database: Database,
    *,
    patience_s: float = PATIENCE_S,
    look_every_s: float = _LOOK_EVERY_S,
) -> Iterator[None]:
    """Lock a catalogue in PostgreSQL; one in SQLite is locked by its data folder.

    Raises InUse, StorageUnavailable.
    """
    if database.engine.dialect.name != "postgresql":
        yield
        return
    lock, closing = _Lock(database.engine), threading.Event()
    lock.acquire_within(patience_s)
    keeper = threading.Thread(
        target=lock.hold,
        args=(closing, look_every_s),
        name="catalogue-lock",
        daemon=True,  # it may wait for a frozen server
    )
    keeper.start()
    try:
        yield
    finally:
        closing.set()
        host_clock.join(keeper, 2.0)


class _Lock:
    def __init__(self, engine: Engine) -> None:
        self._engine, self._throttle = engine, LogThrottle(600.0)
        self._connection: Connection | None = None

    def acquire_within(self, patience_s: float) -> None:
        deadline = host_clock.now_s() + patience_s
        while not (is_held := self._try_lock()):
            if host_clock.now_s() < deadline:
                host_clock.sleep_s(0.1)
                continue
            self._release()
            if is_held is None:
                raise StorageUnavailable("the catalogue does not answer")
            raise InUse(
                "another instance works on the catalogue of database_url; stop it, or "
                "give each its own database"
            )

    def hold(self, closing: threading.Event, every_s: float) -> None:
        """Take the lock again where a restart of the server has released it."""
        while not host_clock.wait(closing, every_s):
            if self._try_lock() is False and self._throttle.is_due():
                log.error("another instance works on the same catalogue; stop one")
        self._release()

    def _try_lock(self) -> bool | None:
        try:
            if self._connection is None:
                raw = self._engine.connect()
                self._connection = raw.execution_options(isolation_level="AUTOCOMMIT")
                self._connection.execute(_KEEP_ALIVE)
            return bool(self._connection.execute(_TAKE).scalar())
        except SQLAlchemyError:
            self._release()
            return None

    def _release(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            with suppress(SQLAlchemyError):
                connection.invalidate()  # not reused from the pool: it owns the lock
                connection.close()
