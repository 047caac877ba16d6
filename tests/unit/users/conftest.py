"""Users in a catalogue of their own."""

import shutil
from dataclasses import replace

import pytest
from argon2 import PasswordHasher

from truepath.catalogue.database import Database
from truepath.users import accounts as passwords
from truepath.users import roles
from truepath.users.accounts import Accounts
from truepath.users.tokens import Moment, Tokens


@pytest.fixture
def database(empty_catalogue, tmp_path):
    shutil.copyfile(empty_catalogue, tmp_path / "catalogue.sqlite")
    database = Database(f"sqlite:///{tmp_path / 'catalogue.sqlite'}", patience_s=2.0)
    yield database
    database.close()


@pytest.fixture
def accounts(database, monkeypatch):
    """Anna, who administers; passwords are hashed in no time."""
    quick = PasswordHasher(time_cost=1, memory_cost=8, parallelism=1)
    monkeypatch.setattr(passwords, "_hasher", quick)
    accounts = Accounts(database)
    accounts.add("anna", roles.Role.ADMINISTRATOR, "a long sentence is easy")
    return accounts


class Clock:
    """Both clocks of a computer, turned by hand."""

    def __init__(self):
        self.now = Moment(wall_s=1e9, boot_s=100.0, boot_id="first")

    def read(self):
        return self.now

    def pass_s(self, seconds):
        wall_s, boot_s = self.now.wall_s + seconds, self.now.boot_s + seconds
        self.now = replace(self.now, wall_s=wall_s, boot_s=boot_s)

    def jump_s(self, seconds):
        self.now = replace(self.now, wall_s=self.now.wall_s + seconds)

    def reboot(self, *, down_s):
        wall_s = self.now.wall_s + down_s
        self.now = Moment(wall_s=wall_s, boot_s=5.0, boot_id=self.now.boot_id + "+")


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def tokens(database, clock):
    return Tokens(database, session_s=3600.0, read_moment=clock.read)
