"""Backup and restore of a data folder: catalogue with jobs and users, Runs, results.

A service may measure meanwhile. The catalogue is one consistent view; the files it
names are closed and do not change any more. A Run that is being recorded is left out
and named: reading it could keep the cell from closing it.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path, PurePosixPath
from typing import IO, Any, Protocol

from truepath.catalogue.database import Database
from truepath.catalogue.job import format_utc_now
from truepath.catalogue.locks import hold_folder
from truepath.catalogue.table_transfer import import_tables, open_export
from truepath.documents.whole_files import sync_to_disk
from truepath.errors import BadInput
from truepath.operation.running_service import find_service
from truepath.settings import Settings

SCHEMA = "backup/1"
MANIFEST, MANIFEST_SUM = "manifest.json", "manifest.sha256"
_CATALOGUE, _FILES = "catalogue", ("runs", "results")
_ROOTS = (_CATALOGUE, *_FILES)
_STAYS = (".lock", "tls", "tmp", "aside-", ".restoring-")  # keys are never backed up
_BUNDLES = "bundles"  # packed from Runs, and packed again on request
_RECORDED = "it is being recorded; keep the folder again once it is closed"
_REPLACED = "it was replaced meanwhile"
_CHUNK = 1 << 20
_DAMAGED = (
    OSError,
    EOFError,
    NotImplementedError,  # a method of compression that no zip file of ours has
    RuntimeError,  # the mark of a cipher
    zipfile.BadZipFile,
    zlib.error,
)


@dataclass(frozen=True, slots=True)
class Stored:
    """Size and digest of a file."""

    bytes: int
    sha256: str


@dataclass(frozen=True, slots=True)
class BackupContent:
    """Content of a backup.

    rows : of the catalogue, by table; files : by name; left_out : and why
    """

    revision: str
    rows: Mapping[str, int]
    files: Mapping[str, Stored]
    left_out: Mapping[str, str]

    @property
    def bytes(self) -> int:
        """Size of all files."""
        return sum(stored.bytes for stored in self.files.values())


def make_backup(settings: Settings, place: Path) -> BackupContent:
    """Back up the data folder of some settings into a folder or a zip file.

    Raises BadInput where there is nothing to back up or something is there already.
    """
    folder = settings.data_dir
    if place.absolute().is_relative_to(folder.absolute()):
        raise BadInput(f"{place}: is inside the data folder; name a place outside it")
    is_served = find_service(settings).is_there
    with (
        closing(Database(settings.database)) as database,
        open_export(database) as export,
        make_archive(place) as archive,
    ):
        rows: dict[str, int] = {}
        files: dict[str, Stored] = {}
        for table in export.tables:
            counted = _Counted(export.read(table))
            name = f"{_CATALOGUE}/{table}.jsonl"
            files[name] = store_chunks(archive, name, counted)
            rows[table] = counted.count
        left_out = _store_files(archive, folder, files, is_served=is_served)
        backup = BackupContent(export.revision, rows, files, left_out)
        _write_manifest(archive, backup)
    return backup


def restore_backup(
    settings: Settings, place: Path, *, force: bool = False
) -> BackupContent:
    """Restore a backup into the data folder of some settings; gives its content.

    Every file is checked before anything is replaced. Data in the folder are moved to
    `aside-TIME` in it, if `force`; else nothing is done.

    Raises BadInput where a file of the backup is damaged or missing, InUse.
    """
    folder = settings.data_dir
    with read_archive(place) as archive, hold_folder(folder):
        backup = _read_manifest(archive)
        present = _list_data(folder)
        if present and not force:
            raise BadInput(
                f"{folder}: holds data already; give another --data-dir, or --force to "
                "move them aside"
            )
        if shutil.disk_usage(folder).free < backup.bytes * 1.1:
            raise BadInput(f"{folder}: has no room for {backup.bytes / 1e9:.2f} GB")
        stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
        draft = folder / f".restoring-{stamp}"
        try:
            _unpack(archive, backup, draft)
            _put_catalogue(settings, backup, draft)
            _exchange(folder, draft, present, folder / f"aside-{stamp}")
        finally:
            shutil.rmtree(draft, ignore_errors=True)
    return backup


class _Counted:
    def __init__(self, lines: Iterator[bytes]) -> None:
        self._lines, self.count = lines, 0

    def __iter__(self) -> Iterator[bytes]:
        for line in self._lines:
            self.count += 1
            yield line


def _store_files(
    archive: Archive, folder: Path, files: dict[str, Stored], *, is_served: bool
) -> dict[str, str]:
    left_out: dict[str, str] = {}
    for source in _list_files(folder):
        name = source.relative_to(folder).as_posix()
        log = source.with_name(f"{source.name}-wal")
        is_run = source.parent.name == "runs" and source.suffix == ".sqlite"
        if is_served and is_run and log.exists():
            left_out[name] = _RECORDED
            continue
        if is_served and name.endswith(("-wal", ".upload", ".tmp")):
            continue
        try:
            files[name] = store_file(archive, name, source)
        except FileNotFoundError:  # a result that is being written again
            left_out[name] = _REPLACED
    return left_out


def _list_files(folder: Path) -> Iterator[Path]:
    for root in _FILES:
        for source in sorted((folder / root).rglob("*")):
            parts = source.relative_to(folder).parts
            is_draft = any(part.endswith((".part", "-shm")) for part in parts)
            if source.is_file() and not is_draft and _BUNDLES not in parts[1:2]:
                yield source


def _write_manifest(archive: Archive, backup: BackupContent) -> None:
    content = {
        "schema": SCHEMA,
        "truepath": version("truepath"),
        "created": format_utc_now(),
        **asdict(backup),
    }
    text = json.dumps(content, indent=1, ensure_ascii=False).encode()
    store_chunks(archive, MANIFEST, [text])
    store_chunks(archive, MANIFEST_SUM, [hashlib.sha256(text).hexdigest().encode()])


def _read_manifest(archive: Archive) -> BackupContent:
    try:
        with (
            archive.open(MANIFEST, "r") as source,
            archive.open(MANIFEST_SUM, "r") as s,
        ):
            text, stated = source.read(), s.read().decode("ascii", "replace").strip()
    except (OSError, KeyError) as error:
        raise BadInput(f"there is no {MANIFEST}: this is no backup") from error
    except Exception as error:
        raise BadInput(f"{MANIFEST}: is damaged ({error})") from error
    if hashlib.sha256(text).hexdigest() != stated:
        raise BadInput(f"{MANIFEST}: is not what was kept (its SHA-256 differs)")
    content: dict[str, Any] = json.loads(text)
    if content.get("schema") != SCHEMA:
        raise BadInput(f"{MANIFEST}: schema {content.get('schema')!r}, not {SCHEMA}")
    files = {check_name(n, _ROOTS): Stored(**s) for n, s in content["files"].items()}
    return BackupContent(
        content["revision"], content["rows"], files, content["left_out"]
    )


def _unpack(archive: Archive, backup: BackupContent, draft: Path) -> None:
    for root in _ROOTS:
        (draft / root).mkdir(parents=True)
    for name, stored in backup.files.items():
        target = draft / name
        target.parent.mkdir(parents=True, exist_ok=True)
        with target.open("xb") as sink:
            for chunk in read_checked(archive, name, stored):
                sink.write(chunk)


def _put_catalogue(settings: Settings, backup: BackupContent, draft: Path) -> None:
    url = settings.database
    if not settings.database_url:
        url = f"sqlite:///{draft / 'catalogue.sqlite'}"
    with closing(Database(url)) as database, _open_lines(backup, draft) as tables:
        import_tables(database, backup.revision, tables)
    shutil.rmtree(draft / _CATALOGUE)


@contextmanager
def _open_lines(
    backup: BackupContent, draft: Path
) -> Iterator[dict[str, Iterator[bytes]]]:
    files = {table: draft / _CATALOGUE / f"{table}.jsonl" for table in backup.rows}
    opened = {table: file.open("rb") for table, file in files.items()}
    try:
        yield {table: iter(file) for table, file in opened.items()}
    finally:
        for file in opened.values():
            file.close()


def _list_data(folder: Path) -> list[Path]:
    return [one for one in sorted(folder.iterdir()) if not one.name.startswith(_STAYS)]


def _exchange(folder: Path, draft: Path, present: list[Path], aside: Path) -> None:
    """Move present files aside, then the draft into their place, the catalogue last."""
    if present:
        aside.mkdir()
    for one in present:
        one.rename(aside / one.name)
    new = sorted(draft.iterdir(), key=lambda one: one.name.startswith(_CATALOGUE))
    for one in new:
        one.rename(folder / one.name)


class Archive(Protocol):
    """Opens files by their names, `runs/one.sqlite`; closed by `make` or `read`."""

    def open(self, name: str, mode: str) -> IO[bytes]:
        """Open a file to read, `r`, or a new one to write, `w`."""
        ...


@contextmanager
def make_archive(place: Path) -> Iterator[Archive]:
    """Make a folder, or a zip file if its name ends so: complete or not at all.

    Raises BadInput where something is there already.
    """
    if place.exists():
        raise BadInput(f"{place}: is there already; name another place")
    place.parent.mkdir(parents=True, exist_ok=True)
    part = place.with_name(f".{place.name}.part")
    _remove(part)
    try:
        if place.suffix == ".zip":
            with zipfile.ZipFile(
                part, "w", zipfile.ZIP_DEFLATED, compresslevel=1
            ) as file:
                yield _Zipped(file)
        else:
            part.mkdir()
            yield _Folder(part)
        os.sync()  # once for all files: it is to outlast a power cut from here on
        part.rename(place)
        sync_to_disk(place.parent)
    finally:
        _remove(part)


@contextmanager
def read_archive(place: Path) -> Iterator[Archive]:
    """Open a folder or zip file. Raises BadInput where it is neither."""
    if place.is_dir():
        yield _Folder(place)
        return
    try:
        file = zipfile.ZipFile(place)
    except (OSError, zipfile.BadZipFile) as error:
        raise BadInput(f"{place}: is no folder and no zip file ({error})") from error
    with file:
        yield _Zipped(file)


def store_file(archive: Archive, name: str, source: Path) -> Stored:
    """Copy a file into an archive."""
    with source.open("rb") as stream:
        return store_chunks(archive, name, iter(lambda: stream.read(_CHUNK), b""))


def store_chunks(archive: Archive, name: str, chunks: Iterable[bytes]) -> Stored:
    """Write a file of an archive from its pieces."""
    digest, count = hashlib.sha256(), 0
    with archive.open(name, "w") as sink:
        for chunk in chunks:
            digest.update(chunk)
            count += len(chunk)
            sink.write(chunk)
    return Stored(count, digest.hexdigest())


def read_checked(archive: Archive, name: str, stored: Stored) -> Iterator[bytes]:
    """Pieces of a file. Raises BadInput that names it where it is damaged.

    Only after the last piece it is known to be intact.
    """
    digest, count = hashlib.sha256(), 0
    try:
        with archive.open(name, "r") as source:
            while chunk := source.read(_CHUNK):
                digest.update(chunk)
                count += len(chunk)
                yield chunk
    except (KeyError, FileNotFoundError) as error:
        raise BadInput(f"{name}: is missing from the backup") from error
    except _DAMAGED as error:
        raise BadInput(f"{name}: is damaged in the backup ({error})") from error
    if (count, digest.hexdigest()) != (stored.bytes, stored.sha256):
        raise BadInput(
            f"{name}: is not what was kept (its SHA-256 or size differs); take another "
            "copy of the backup"
        )


def check_name(name: str, roots: Iterable[str]) -> str:
    """The name itself. Raises BadInput where it leads out of these folders."""
    path = PurePosixPath(name)
    is_inside = path.parts[:1] and path.parts[0] in roots and ".." not in path.parts
    if not is_inside or "\\" in name or "\0" in name or str(path) != name:
        raise BadInput(f"the backup names {name!r}, which is no file of a data folder")
    return name


class _Folder:
    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def open(self, name: str, mode: str) -> IO[bytes]:
        place = self._folder / name
        if mode == "w":
            place.parent.mkdir(parents=True, exist_ok=True)
            return place.open("xb")
        return place.open("rb")


class _Zipped:
    def __init__(self, file: zipfile.ZipFile) -> None:
        self._file = file

    def open(self, name: str, mode: str) -> IO[bytes]:
        if mode == "w":
            return self._file.open(name, "w", force_zip64=True)
        return self._file.open(name)


def _remove(place: Path) -> None:
    if place.is_dir():
        shutil.rmtree(place)
    else:
        place.unlink(missing_ok=True)
