"""A catalogue that cannot be used is told in one sentence, and left as it is."""

import os
import shutil
import sqlite3
import tempfile
from contextlib import closing
from pathlib import Path

import pytest
from sqlalchemy import text

from truepath.catalogue.catalogue_file import check_catalogue
from truepath.catalogue.errors import (
    CatalogueDamaged,
    CatalogueReadOnly,
    StorageUnavailable,
)
from truepath.catalogue.job import Job, JobKind
from truepath.catalogue.store.database import Database
from truepath.catalogue.store.store import Store


@pytest.fixture
def file(empty_catalogue, tmp_path):
    """A catalogue of some pages."""
    file = tmp_path / "catalogue.sqlite"
    shutil.copyfile(empty_catalogue, file)
    database = Database(f"sqlite:///{file}")
    store = Store(database, lambda _: None)
    for _ in range(20):
        store.create(Job(JobKind.ANALYSE), plan={"long": "x" * 2000})
    database.close()
    return file


def open_catalogue(file):
    database = Database(f"sqlite:///{file}")
    try:
        database.migrate()
    finally:
        database.close()


def flip(file):
    content = bytearray(file.read_bytes())
    content[4096 * 3 : 4096 * 5] = b"\xa5" * 8192
    file.write_bytes(content)


def execute(file, query):
    with closing(sqlite3.connect(file)) as other:
        other.execute(query)
        other.commit()


def replace_by_folder(file):
    file.unlink()
    file.mkdir()
    (file / "kept").write_text("by somebody")


def drop_column(file):
    execute(file, "ALTER TABLE jobs DROP COLUMN attempts")


def replace_by_other(file):
    file.unlink()
    execute(file, "CREATE TABLE shopping (item TEXT)")


DAMAGES = [
    (lambda file: file.write_bytes(b""), "is empty"),
    (lambda file: file.write_bytes(b"no database " * 99), "is not a SQLite file"),
    (lambda file: os.truncate(file, file.stat().st_size // 2), "is damaged"),
    (flip, "is damaged"),
    (replace_by_folder, "is a folder where the catalogue should be"),
    (drop_column, "has no jobs.attempts although it is of schema"),
    (replace_by_other, "is a SQLite file of something else"),
]


def content_of(place):
    files = place.rglob("*") if place.is_dir() else [place]
    return {str(f): f.read_bytes() for f in files if f.is_file()}


@pytest.mark.parametrize(("damage", "said"), DAMAGES)
@pytest.mark.fault_row(37)
def test_a_damaged_catalogue_is_told_and_left_as_it_is(file, damage, said):
    damage(file)
    before = content_of(file.parent)
    with pytest.raises(CatalogueDamaged, match=said) as told:
        open_catalogue(file)
    assert str(told.value).startswith(f"{file}: ")
    assert "truepath catalogue rebuild" in str(told.value)
    after = content_of(file.parent).items()
    assert {k: v for k, v in after if not k.endswith(("-wal", "-shm"))} == before


def test_a_catalogue_with_a_log_left_behind_is_in_order(file):
    """As a killed service leaves it."""
    with closing(sqlite3.connect(file)) as writer:
        writer.execute("UPDATE jobs SET version = 7")
        writer.commit()
        copy = file.with_name("copy.sqlite")
        for end in ("", "-wal"):
            shutil.copyfile(f"{file}{end}", f"{copy}{end}")
    database = Database(f"sqlite:///{copy}")
    database.migrate()
    with database.read() as connection:
        assert connection.execute(text("SELECT max(version) FROM jobs")).scalar() == 7
    database.close()


def test_a_catalogue_that_cannot_be_written_says_so(file):
    account = os.geteuid()
    with tempfile.TemporaryDirectory(prefix="catalogue") as public:
        Path(public).chmod(0o755)
        here = shutil.copyfile(file, Path(public) / "catalogue.sqlite")
        here.chmod(0o444)
        os.seteuid(account or 65534)  # an account without rights
        try:
            with pytest.raises(CatalogueReadOnly, match=r"be written .*; give its"):
                open_catalogue(here)
        finally:
            os.seteuid(account)


def test_a_catalogue_that_another_program_holds_is_not_called_damaged(file):
    with closing(sqlite3.connect(file, isolation_level=None)) as other:
        other.execute("PRAGMA journal_mode=DELETE")
        other.execute("BEGIN EXCLUSIVE")
        with pytest.raises(StorageUnavailable, match="in use"):
            check_catalogue(file, "0001", patience_s=0.05)
        other.execute("ROLLBACK")


@pytest.mark.fault_row(37)
def test_a_catalogue_that_is_damaged_under_the_service_says_what_to_do(file):
    database = Database(f"sqlite:///{file}")
    store = Store(database, lambda _: None)
    content = file.read_bytes()
    file.write_bytes(content[:4096] + b"\xa5" * (len(content) - 4096))
    job = Job(JobKind.ANALYSE)
    for use in (lambda: store.list_page(99), lambda: store.create(job)):
        with pytest.raises(StorageUnavailable, match="truepath catalogue rebuild"):
            use()
    database.close()
