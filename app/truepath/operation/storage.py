"""The data folder: its disk, its rights, its catalogue."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from truepath.catalogue.data_dir_lock import MOUNTS, find_file_system, is_network_share
from truepath.catalogue.errors import StorageUnavailable
from truepath.catalogue.store.database import Database
from truepath.errors import TruepathError
from truepath.jobs.dispatch.catalogue_rebuild import check_against_disk
from truepath.operation.finding import Finding, Grade
from truepath.settings import Settings

LEAST_FREE_BYTES = 500 << 20
"""Below it no measurement begins."""
AMPLE_BYTES = 5 << 30


def check_storage(settings: Settings) -> Iterator[Finding]:
    """Rights, file system, room and catalogue of the data folder."""
    folder = settings.data_dir
    place = find_existing(folder)
    yield check_rights(folder, place)
    yield check_file_system(place)
    yield check_room(place)
    yield check_catalogue_file(settings)


def find_existing(folder: Path) -> Path:
    """The folder, or the nearest one above that exists."""
    place = folder.absolute()
    return next(p for p in (place, *place.parents) if p.exists())


def check_rights(folder: Path, place: Path) -> Finding:
    """Whether this account may write; `place` as `find_existing` has it."""
    if not place.is_dir():
        remedy = "give another data_dir"
        return Finding("data folder", Grade.WRONG, f"{place} is no folder", remedy)
    if not os.access(place, os.R_OK | os.W_OK | os.X_OK):
        text = f"{place}: this account may not write there"
        remedy = "give the folder to the account of the service, or set data_dir"
        return Finding("data folder", Grade.WRONG, text, remedy)
    is_new = place != folder.absolute()
    text = f"{folder} does not exist yet; it is made" if is_new else str(folder)
    return Finding("data folder", Grade.OK, text)


def check_file_system(place: Path, mounts: Path = MOUNTS) -> Finding:
    """Whether the folder is on a disk of this computer."""
    kind = find_file_system(place.resolve(), mounts)
    if kind is None:
        return Finding("file system", Grade.UNTOLD, "the system does not tell")
    if is_network_share(kind):
        remedy = "set data_dir to a disk of this computer"
        text = f"{place} is on a share of the network ({kind})"
        return Finding("file system", Grade.WRONG, text, remedy)
    return Finding("file system", Grade.OK, kind)


def check_room(place: Path) -> Finding:
    """Whether the disk has room for Runs."""
    free = shutil.disk_usage(place).free
    text = f"{free / 1e9:.1f} GB are free"
    if free < LEAST_FREE_BYTES:
        remedy = "free some space: below 0.5 GB no measurement begins"
        return Finding("disk", Grade.WRONG, text, remedy)
    if free < AMPLE_BYTES:
        remedy = "free some space: an hour of measuring takes about 0.2 GB"
        return Finding("disk", Grade.WARNING, text, remedy)
    return Finding("disk", Grade.OK, text)


def check_catalogue_file(settings: Settings) -> Finding:
    """Whether the catalogue can be used and agrees with the Runs on disk."""
    if not settings.database_url and not settings.data_dir.exists():
        return Finding("catalogue", Grade.OK, "there is none yet")
    database = Database(settings.database)
    try:
        found = check_against_disk(database, settings.data_dir / "runs")
    except StorageUnavailable as error:
        remedy = "look at the database server, or try again"
        return Finding("catalogue", Grade.WRONG, str(error), remedy)
    except TruepathError as error:
        return Finding("catalogue", Grade.WRONG, str(error))
    finally:
        database.close()
    if found["revision"] is None:
        return Finding("catalogue", Grade.OK, "there is none yet")
    text = f"schema {found['revision']}, {found['jobs']} jobs, {found['runs']} Runs"
    gone = len(found["rows_without_file"])
    if gone:
        remedy = "see truepath catalogue check; bring the files back from a backup"
        return Finding(
            "catalogue", Grade.WARNING, f"{text}; files of {gone} have gone", remedy
        )
    return Finding("catalogue", Grade.OK, text)
