"""The users of the service in its catalogue."""

from __future__ import annotations

import re
from dataclasses import dataclass

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError
from sqlalchemy import Connection, delete, func, insert, select, update

from truepath.catalogue.database import Database
from truepath.catalogue.job import format_utc_now
from truepath.catalogue.schema import tokens, users
from truepath.errors import BadInput, NotFound
from truepath.users.errors import UserConflict
from truepath.users.roles import PERSONAL_ROLES, Role

SHORTEST, LONGEST = 10, 200

_hasher = PasswordHasher()
_NOBODY = (  # a hash of the same cost; to make one takes a third of a second
    "$argon2id$v=19$m=65536,t=3,p=4$7L/cmRntCvkbKmd5KIKS7Q$+fZY/B"
    "fwkQnxlvS9zlKdJncZhKvVBtVvfUh1JBU3RfI"
)


def hash_password(password: str) -> str:
    """Hash of a password. Raises BadInput if it is too short or too long."""
    if not SHORTEST <= len(password) <= LONGEST:
        raise BadInput(
            f"the password has {len(password)} characters; "
            f"choose {SHORTEST} to {LONGEST}"
        )
    return _hasher.hash(password)


def is_password(password: str, kept: str | None) -> bool:
    """Whether it is the password. Without a user it takes just as long."""
    try:
        return _hasher.verify(kept or _NOBODY, password) and kept is not None
    except (VerificationError, InvalidHashError):
        return False


_NAME = re.compile(r"^\w[\w.@-]{0,63}$")


@dataclass(frozen=True, slots=True)
class User:
    """A person who may log in."""

    name: str
    role: Role
    created: str


class Accounts:
    """Adds, changes and removes users; safe for threads and processes."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def list_all(self) -> list[User]:
        """Sorted by name."""
        query = select(users).order_by(users.c.name)
        with self._database.read() as connection:
            return [
                User(row.name, Role(row.role), row.created)
                for row in connection.execute(query)
            ]

    def find(self, name: str) -> tuple[User, str] | None:
        """A user with the hash of the password; None if there is none."""
        with self._database.read() as connection:
            row = connection.execute(select(users).where(users.c.name == name)).first()
        if row is None:
            return None
        return User(row.name, Role(row.role), row.created), row.password_hash

    def add(self, name: str, role: Role, password: str) -> User:
        """Raises BadInput, UserConflict if there is a user of that name."""
        check_name(name)
        _require_personal(role)
        kept = hash_password(password)
        user = User(name, role, format_utc_now())

        def change(connection: Connection) -> None:
            known = select(users.c.name).where(users.c.name == name)
            if connection.execute(known).first() is not None:
                raise UserConflict(f"there is a user {name} already")
            row = {"name": name, "role": role, "created": user.created}
            connection.execute(insert(users).values(**row, password_hash=kept))

        self._database.write(change)
        return user

    def set_role(self, name: str, role: Role) -> Role:
        """Change a role, effective at once; the result is the role before.

        Raises NotFound, UserConflict for the last administrator.
        """
        _require_personal(role)

        def change(connection: Connection) -> Role:
            before = _read_role(connection, name)
            if role is not Role.ADMINISTRATOR:
                _require_an_administrator(connection, name)
            query = update(users).where(users.c.name == name).values(role=role)
            connection.execute(query)
            return before

        return self._database.write(change)

    def set_password(self, name: str, password: str) -> None:
        """Also ends all sessions of the user. Raises NotFound."""
        kept = hash_password(password)

        def change(connection: Connection) -> None:
            _read_role(connection, name)
            query = update(users).where(users.c.name == name)
            connection.execute(query.values(password_hash=kept))
            _end_sessions(connection, name)

        self._database.write(change)

    def remove(self, name: str) -> Role:
        """Remove a user and all sessions; the result is the role.

        Raises NotFound, UserConflict for the last administrator.
        """

        def change(connection: Connection) -> Role:
            role = _read_role(connection, name)
            _require_an_administrator(connection, name)
            connection.execute(delete(users).where(users.c.name == name))
            _end_sessions(connection, name)
            return role

        return self._database.write(change)


def check_name(name: str) -> None:
    """Raise BadInput for an invalid name of a user or key."""
    if not _NAME.match(name):
        raise BadInput(
            f"{name!r} is no name; use 1 to 64 letters, digits and _ . @ -, "
            "a letter or digit first"
        )


def _require_personal(role: Role) -> None:
    if role not in PERSONAL_ROLES:
        raise BadInput(
            f"{role} is a role of programs; make an API key, or choose one of "
            + ", ".join(PERSONAL_ROLES)
        )


def _read_role(connection: Connection, name: str) -> Role:
    query = select(users.c.role).where(users.c.name == name)
    role = connection.execute(query).scalar()
    if role is None:
        raise NotFound(f"there is no user {name}")
    return Role(role)


def _require_an_administrator(connection: Connection, name: str) -> None:
    if _read_role(connection, name) is not Role.ADMINISTRATOR:
        return
    others = (users.c.role == Role.ADMINISTRATOR) & (users.c.name != name)
    if not connection.execute(select(func.count()).where(others)).scalar():
        raise UserConflict(f"{name} is the last administrator; make another one first")


def _end_sessions(connection: Connection, name: str) -> None:
    own = (tokens.c.kind == "session") & (tokens.c.name == name)
    connection.execute(delete(tokens).where(own))
