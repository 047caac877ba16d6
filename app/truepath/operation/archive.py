"""Files under names in one folder or one zip file, each with its size and SHA-256."""

from __future__ import annotations

import hashlib
import os
import shutil
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO, Protocol

from truepath.documents.whole_files import sync_to_disk
from truepath.errors import BadInput

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
