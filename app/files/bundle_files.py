"""The files of a measurement bundle, in a folder or in a zip archive.

Nothing is ever extracted: members are read into memory, by name, up to a limit each, so
an archive can neither leave its folder nor fill the disk.
"""

from __future__ import annotations

import zipfile
import zlib
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

from app.errors import BundleError
from app.files.whole_files import MAX_TEXT_BYTES

FILES = (
    "machine.json",
    "path.csv",
    "points.csv",
    "tracker.parquet",
    "tracker.csv",
    "environment.csv",
    "reference.csv",
)
MAX_BYTES = 4 << 30
MAX_MEMBERS = 1000


class BundleFiles(ABC):
    """Read access to the files of one bundle.

    names : the files of `FILES` that are there
    """

    names: frozenset[str]

    @abstractmethod
    def read(self, name: str) -> bytes:
        """Return a whole file. Raises BundleError if it is too large or damaged."""

    def __contains__(self, name: str) -> bool:
        return name in self.names


@contextmanager
def open_bundle(path: str | Path) -> Iterator[BundleFiles]:
    """Open a folder or an archive."""
    place = Path(path)
    if place.is_dir():
        yield _Folder(place)
    elif place.is_file():
        remedy = "give the folder of a bundle or a .zip of it"
        with _open_archive(place, place.name, remedy) as archive:
            yield _Archive(archive, place.name)
    else:
        raise BundleError(
            "no such folder or file", file=str(path), remedy="check the path"
        )


def check_archive(file: Path, limit_bytes: int) -> None:
    """Refuse an archive that would unpack to more than a limit. Raises BundleError."""
    remedy = "send the .zip of a measurement bundle"
    with _open_archive(file, "bundle", remedy) as archive:
        total = sum(info.file_size for info in archive.infolist())
    if total > limit_bytes:
        raise BundleError(
            f"unpacks to {total >> 20} MiB, more than {limit_bytes >> 20} MiB",
            file="bundle",
            remedy="use tracker.parquet, or raise max_upload_mb",
        )


def _limit(name: str) -> int:
    return MAX_BYTES if name.startswith("tracker.") else MAX_TEXT_BYTES


def _too_large(name: str) -> BundleError:
    return BundleError(f"is larger than {_limit(name) >> 20} MiB", file=name)


class _Folder(BundleFiles):
    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.names = frozenset(n for n in FILES if (folder / n).is_file())

    def read(self, name: str) -> bytes:
        file = self._folder / name
        if file.stat().st_size > _limit(name):
            raise _too_large(name)
        return file.read_bytes()


class _Archive(BundleFiles):
    """Members at the top of the archive, or all in one folder of it."""

    def __init__(self, archive: zipfile.ZipFile, label: str) -> None:
        self._archive = archive
        self._members = _list_members(archive, label)
        self.names = frozenset(self._members)

    def read(self, name: str) -> bytes:
        limit = _limit(name)
        try:
            with self._archive.open(self._members[name]) as member:
                data = member.read(limit + 1)
        except (zipfile.BadZipFile, zlib.error, EOFError, OSError) as error:
            raise BundleError(
                "is damaged in the archive", file=name, remedy="pack it again"
            ) from error
        except (RuntimeError, NotImplementedError) as error:
            raise BundleError(
                f"cannot be unpacked ({error})",
                file=name,
                remedy="pack it without a password, with the deflate method",
            ) from error
        if len(data) > limit:
            raise _too_large(name)
        return data


def _open_archive(file: Path, label: str, remedy: str) -> zipfile.ZipFile:
    try:
        return zipfile.ZipFile(file)
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
        problem = "is truncated or not a zip archive"
        raise BundleError(problem, file=label, remedy=remedy) from error


def _list_members(archive: zipfile.ZipFile, label: str) -> dict[str, zipfile.ZipInfo]:
    infos = [info for info in archive.infolist() if not info.is_dir()]
    if len(infos) > MAX_MEMBERS:
        raise BundleError(f"holds more than {MAX_MEMBERS} files", file=label)
    found: dict[str, zipfile.ZipInfo] = {}
    folders: set[str] = set()
    for info in infos:
        member = PurePosixPath(info.filename.replace("\\", "/"))
        if member.is_absolute() or ".." in member.parts or ":" in member.parts[0]:
            raise BundleError(
                f"member {info.filename!r} points out of the archive",
                file=label,
                remedy="pack the folder of the bundle itself",
            )
        if member.name not in FILES or len(member.parts) > 2:
            continue
        if member.name in found:
            raise BundleError("is in the archive twice", file=member.name)
        found[member.name] = info
        folders.add(str(member.parent))
    if len(folders) > 1:
        raise BundleError(
            f"spreads a bundle over {', '.join(sorted(folders))}",
            file=label,
            remedy="pack one folder",
        )
    return found
