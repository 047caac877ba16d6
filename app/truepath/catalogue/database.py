"""The catalogue's connection: SQLite or PostgreSQL, the same code.

Writers take turns behind one lock, so that event identifiers are committed in order and
SQLite never has two writers of ours. Every SQLite connection gets write-ahead logging,
full synchronisation, foreign keys and a busy timeout.
"""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, TypeVar

import structlog
from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, Engine, create_engine, event, text
from sqlalchemy.exc import (
    ArgumentError,
    DatabaseError,
    NoSuchModuleError,
    OperationalError,
)
from sqlalchemy.pool import ConnectionPoolEntry

from truepath.catalogue.errors import (
    CatalogueDamaged,
    CatalogueReadOnly,
    SchemaTooNew,
    SchemaTooOld,
    StorageFull,
    StorageUnavailable,
)
from truepath.catalogue.schema import metadata
from truepath.errors import BadInput
from truepath.log_throttle import LogThrottle
from truepath_drivers import host_clock

log = structlog.get_logger(__name__)
T = TypeVar("T")

_MIGRATIONS = Path(__file__).parent / "migrations"
_FULL = "disk is full", "No space left"  # in messages of SQLite and PostgreSQL
_DAMAGED = "malformed", "not a database"
_MAGIC = b"SQLite format 3\0"
_REVISION = "alembic_version"
_PRAGMAS = (
    "journal_mode=WAL",
    "synchronous=FULL",
    "foreign_keys=ON",
    "busy_timeout=5000",
)


class Database:
    """One catalogue. `migrate` before anything else.

    patience_s : how long a write is repeated while another program holds the lock
    """

    def __init__(self, url: str, *, patience_s: float = 15.0) -> None:
        self._patience_s = patience_s
        self._writer, self._throttle = threading.RLock(), LogThrottle()
        self.engine = _engine(url)

    @contextmanager
    def read(self) -> Iterator[Connection]:
        """Open a consistent view."""
        with _as_storage_errors(), self.engine.connect() as connection:
            yield connection

    @contextmanager
    def read_snapshot(self) -> Iterator[Connection]:
        """Open a view that stays the same over several queries, despite writers."""
        with _as_storage_errors(), self.engine.connect() as raw:
            connection = raw
            if self.engine.dialect.name == "postgresql":
                connection = raw.execution_options(isolation_level="REPEATABLE READ")
            with connection.begin():
                yield connection

    def write(
        self, change: Callable[[Connection], T], then: Callable[[T], None] | None = None
    ) -> T:
        """Run `change` in one transaction, alone, repeated while the file is locked.

        then : runs before the next writer

        Raises StorageUnavailable after `patience_s`, StorageFull at once.
        """
        deadline = host_clock.now_s() + self._patience_s
        with self._writer:
            result = self._commit(change, deadline)
            if then is not None:
                then(result)
            return result

    def migrate(self, revision: str | None = None) -> None:
        """Bring the tables up to this version; a SQLite file is copied first.

        revision : that of a backup, to put its rows back; else the newest

        Raises SchemaTooNew, SchemaTooOld, CatalogueDamaged, CatalogueReadOnly.
        """
        before = self.check()
        script = ScriptDirectory(str(_MIGRATIONS))
        if revision is None:
            revision = script.get_current_head() or ""
        _require_known(script, revision, "the backup")
        if before == revision:
            return
        if before is not None:
            self._copy_aside(before)
        with _as_storage_errors(), self.engine.begin() as connection:
            if _is_psycopg(self.engine):
                from truepath.catalogue.postgres_connection import (
                    wait_for_migration,
                )

                wait_for_migration(connection)
            config = Config(attributes={"connection": connection})
            config.set_main_option("script_location", str(_MIGRATIONS))
            command.upgrade(config, revision)
        self.engine.dispose()  # that connection is more patient than any request
        log.info("catalogue migrated", before=before, now=revision)

    @property
    def file(self) -> Path | None:
        """The file of a catalogue in SQLite, else None."""
        name = self.engine.url.database
        is_file = self.engine.dialect.name == "sqlite" and name
        return Path(name) if is_file and name else None

    def check(self) -> str | None:
        """Schema of the catalogue, None where there is none yet.

        Changes nothing. Raises SchemaTooNew, SchemaTooOld, CatalogueDamaged,
        CatalogueReadOnly.
        """
        script = ScriptDirectory(str(_MIGRATIONS))
        if self.file is not None:
            check_catalogue(self.file, script.get_current_head() or "")
            if not self.file.exists():
                return None
        with _as_storage_errors(), self.engine.connect() as connection:
            revision = MigrationContext.configure(connection).get_current_revision()
        if revision is not None:
            _require_known(script, revision, str(self.file or self.engine.url))
        return revision

    def ready(self) -> bool:
        """Whether the catalogue answers a query."""
        try:
            with self.read() as connection:
                connection.execute(text("SELECT 1"))
        except StorageUnavailable:
            return False
        return True

    def close(self) -> None:
        """Release every connection."""
        self.engine.dispose()

    def _commit(self, change: Callable[[Connection], T], deadline: float) -> T:
        while True:
            try:
                with self.engine.connect() as raw:
                    connection = raw.execution_options(truepath_writes=True)
                    with connection.begin():
                        return change(connection)
            except OperationalError as error:
                if any(sign in str(error.orig) for sign in _FULL):
                    text = f"the catalogue cannot be written: {error.orig}"
                    raise StorageFull(text) from error
                if host_clock.now_s() > deadline:
                    raise StorageUnavailable(_busy_text(error)) from error
                if self._throttle.is_due():
                    log.warning("catalogue is busy", reason=str(error.orig))
                host_clock.sleep_s(0.1)
            except DatabaseError as error:
                _reject_damaged(error)
                raise

    def _copy_aside(self, revision: str) -> None:
        file = self.file
        if file is None:
            return
        stamp = int(host_clock.wall_s())
        while (
            copy := file.with_name(f"{file.stem}.before-{revision}-{stamp}.sqlite")
        ).exists():
            stamp += 1  # tried again within a second
        with self.engine.connect() as connection:
            raw = connection.execution_options(isolation_level="AUTOCOMMIT")
            raw.execute(text("VACUUM INTO :copy"), {"copy": str(copy)})
        log.info("catalogue copied before its migration", copy=str(copy))


def check_catalogue(file: Path, newest: str, *, patience_s: float = 5.0) -> None:
    """Check that the file of a catalogue is intact, or that there is none. Read-only.

    newest : the schema whose tables are known
    patience_s : how long another program may hold it

    Raises CatalogueDamaged, CatalogueReadOnly, and StorageUnavailable while another
    program holds it.
    """
    if not file.exists() and not file.is_symlink():
        return
    _check_file(file)
    address = f"{file.absolute().as_uri()}?mode=ro"
    try:
        with closing(
            sqlite3.connect(address, uri=True, timeout=patience_s)
        ) as database:
            (found,) = database.execute("PRAGMA quick_check(1)").fetchone()
            if found != "ok":
                raise CatalogueDamaged(file, f"is damaged ({' '.join(found.split())})")
            _check_tables(file, database, newest)
    except sqlite3.DatabaseError as error:
        if "locked" in str(error) or "busy" in str(error):
            raise StorageUnavailable(f"the catalogue is in use: {error}") from error
        raise CatalogueDamaged(file, f"is damaged ({error})") from error


def _check_file(file: Path) -> None:
    if not file.is_file():
        what = "a folder" if file.is_dir() else "no file"
        raise CatalogueDamaged(file, f"is {what} where the catalogue should be")
    try:
        with file.open("r+b") as source:
            head = source.read(len(_MAGIC))
    except OSError as error:
        raise CatalogueReadOnly(
            f"{file}: cannot be written ({error.strerror}), so the service cannot keep "
            "its jobs; give its account the right to read and write the file"
        ) from error
    if head != _MAGIC:
        what = "is not a SQLite file" if head else "is empty"
        raise CatalogueDamaged(file, what)


def _check_tables(file: Path, database: sqlite3.Connection, newest: str) -> None:
    query = "SELECT name FROM sqlite_master WHERE type = 'table'"
    tables = {name for (name,) in database.execute(query)}
    if not tables:
        return  # killed before the first schema existed
    if _REVISION not in tables:
        raise CatalogueDamaged(file, "is a SQLite file of something else")
    revision = database.execute(f"SELECT version_num FROM {_REVISION}").fetchall()  # noqa: S608
    if revision != [(newest,)]:
        return
    for table in metadata.sorted_tables:
        there = {row[1] for row in database.execute(f"PRAGMA table_info({table.name})")}
        missing = sorted({column.name for column in table.columns} - there)
        if missing:
            what = f"has no {table.name}.{missing[0]} although it is of schema {newest}"
            raise CatalogueDamaged(file, what)


@contextmanager
def _as_storage_errors() -> Iterator[None]:
    try:
        yield
    except OperationalError as error:
        raise StorageUnavailable(_busy_text(error)) from error
    except DatabaseError as error:
        _reject_damaged(error)
        raise


def _reject_damaged(error: DatabaseError) -> None:
    if any(sign in str(error.orig) for sign in _DAMAGED):
        raise StorageUnavailable(
            f"the catalogue is damaged ({error.orig}); stop the service, then run "
            "`truepath catalogue rebuild` with its settings"
        ) from error


def _busy_text(error: OperationalError) -> str:
    return f"the catalogue does not answer: {error.orig}"


def _require_known(script: ScriptDirectory, revision: str, place: str) -> None:
    if revision in {step.revision for step in script.walk_revisions()}:
        return
    oldest = script.get_base() or ""
    if revision < oldest:  # they are numbered in four digits
        raise SchemaTooOld(
            f"{place} has schema {revision}, older than {oldest}, the first that this "
            "version opens; it is left as it is. Open it once with the version of "
            f"Truepath before this one, which brings it to {oldest}, then with this one"
        )
    raise SchemaTooNew(
        f"{place} has schema {revision}, newer than this version knows; "
        "start the version that wrote it, or give another data folder"
    )


def _engine(url: str) -> Engine:
    try:
        # As many connections as there are threads of requests.
        engine = create_engine(
            url,
            pool_size=20,
            max_overflow=40,
            pool_pre_ping=not url.startswith("sqlite"),
        )
    except (ArgumentError, NoSuchModuleError, ModuleNotFoundError) as error:
        raise BadInput(f"setting database_url: {error}") from error
    if engine.dialect.name == "sqlite":
        event.listen(engine, "connect", _prepare_sqlite)
        event.listen(engine, "begin", _begin_sqlite)
    elif _is_psycopg(engine):
        from truepath.catalogue.postgres_connection import limit_waits

        limit_waits(engine)
    return engine


def _is_psycopg(engine: Engine) -> bool:
    return engine.dialect.driver == "psycopg"


def _prepare_sqlite(dbapi_connection: Any, _: ConnectionPoolEntry) -> None:
    # Transactions are begun by `_begin_sqlite`, not by the module behind our back.
    dbapi_connection.isolation_level = None
    # Its own knows no letters beyond ASCII: who seeks "müller" finds "Müller".
    dbapi_connection.create_function("lower", 1, _fold_case, deterministic=True)
    for pragma in _PRAGMAS:
        dbapi_connection.execute(f"PRAGMA {pragma}")


def _fold_case(text: Any) -> Any:
    return text.lower() if isinstance(text, str) else text


def _begin_sqlite(connection: Connection) -> None:
    # A transaction that will write takes the lock at once: upgrading a read to a write
    # fails without waiting when another connection wrote in between.
    options = connection.get_execution_options()
    if options.get("isolation_level") == "AUTOCOMMIT":
        return
    writes = options.get("truepath_writes", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")
