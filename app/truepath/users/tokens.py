"""Sessions of people and API keys of programs: opaque tokens, stored as their hash.

Their age is independent of jumps of the wall clock.
"""

from __future__ import annotations

import hashlib
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Row, delete, insert, select

from truepath.catalogue.database import Database
from truepath.catalogue.job import format_utc_now
from truepath.catalogue.schema import tokens, users
from truepath.errors import BadInput, NotFound
from truepath.users.accounts import check_name
from truepath.users.errors import UserConflict
from truepath.users.roles import KEY_ROLES, Actor, Role
from truepath_drivers import host_clock

_PREFIX = "tp_"  # by which scanners find a key where none should be
_DAY_S = 86400.0
_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


@dataclass(frozen=True, slots=True)
class Moment:
    """One moment on both clocks.

    wall_s : seconds of the epoch, by the wall clock
    boot_s : seconds since the computer was started, those asleep among them
    boot_id : identifies the boot; empty where unknown
    """

    wall_s: float
    boot_s: float
    boot_id: str

    def age_s(self, now: Moment) -> float:
        """By the clock of the boot; across a reboot by the wall clock."""
        if self.boot_id and self.boot_id == now.boot_id:
            return now.boot_s - self.boot_s
        return max(0.0, now.wall_s - self.wall_s)


def read_moment() -> Moment:
    """The present moment on both clocks."""
    try:
        boot_id = _BOOT_ID.read_text(encoding="ascii").strip()
    except OSError:
        boot_id = ""
    boot_s = time.clock_gettime(time.CLOCK_BOOTTIME)
    return Moment(host_clock.wall_s(), boot_s, boot_id)


@dataclass(frozen=True, slots=True)
class Key:
    """An API key, without its token. `expires_in_s` is None where it does not."""

    name: str
    role: Role
    created: str
    expires_in_s: float | None


class Tokens:
    """Makes, finds and revokes tokens; safe for threads and processes.

    session_s : how long a session lasts
    """

    def __init__(
        self,
        database: Database,
        *,
        session_s: float,
        read_moment: Callable[[], Moment] = read_moment,
    ) -> None:
        self._database, self.session_s = database, session_s
        self._read_moment = read_moment

    def open_session(self, name: str) -> str:
        """Token of a new session of a user; deletes sessions that ended."""
        token, row = self._make(kind="session", name=name, lifetime_s=self.session_s)

        def change(connection: Connection) -> None:
            self._delete_ended(connection)
            connection.execute(insert(tokens).values(**row))

        self._database.write(change)
        return token

    def create_key(self, name: str, role: Role, days: float | None = None) -> str:
        """Token of a new API key, which is shown this once.

        Raises BadInput, UserConflict if a key or a user has that name.
        """
        check_name(name)
        if role not in KEY_ROLES:
            raise BadInput(f"an API key is one of {', '.join(KEY_ROLES)}, not {role}")
        lifetime_s = None if days is None else days * _DAY_S
        token, row = self._make(
            kind="key", name=name, role=str(role), lifetime_s=lifetime_s
        )

        def change(connection: Connection) -> None:
            for table in (users, tokens):
                query = select(table.c.name).where(table.c.name == name)
                if connection.execute(query).first() is not None:
                    raise UserConflict(f"there is a user or a key {name} already")
            connection.execute(insert(tokens).values(**row))

        self._database.write(change)
        return token

    def list_keys(self) -> list[Key]:
        """Sorted by name."""
        query = select(tokens).where(tokens.c.kind == "key").order_by(tokens.c.name)
        with self._database.read() as connection:
            rows = connection.execute(query).all()
        return [
            Key(row.name, Role(row.role), row.created, self._compute_remaining_s(row))
            for row in rows
        ]

    def revoke_key(self, name: str) -> None:
        """Effective at once. Raises NotFound."""
        own = (tokens.c.kind == "key") & (tokens.c.name == name)
        query = delete(tokens).where(own)
        if self._database.write(lambda c: c.execute(query).rowcount) == 0:
            raise NotFound(f"there is no API key {name}")

    def end(self, token: str) -> None:
        """Does nothing for an unknown or ended session."""
        own = (tokens.c.kind == "session") & (tokens.c.sha256 == _hash(token))
        query = delete(tokens).where(own)
        self._database.write(lambda connection: connection.execute(query).rowcount)

    def find(self, token: str) -> Actor | None:
        """Owner of a token; None if it is unknown, has expired or was revoked.

        The role of a user is the present one.
        """
        query = (
            select(tokens, users.c.role.label("user_role"))
            .join(users, users.c.name == tokens.c.name, isouter=True)
            .where(tokens.c.sha256 == _hash(token))
        )
        with self._database.read() as connection:
            row = connection.execute(query).first()
        if row is None:
            return None
        left_s = self._compute_remaining_s(row)
        role = row.role or row.user_role
        if role is None or (left_s is not None and left_s <= 0):
            return None
        return Actor(row.name, Role(role), is_person=row.kind == "session")

    def _make(self, **columns: Any) -> tuple[str, dict[str, Any]]:
        token, now = _PREFIX + secrets.token_urlsafe(32), self._read_moment()
        row = {
            "sha256": _hash(token),
            "created": format_utc_now(),
            "created_s": now.wall_s,
            "boot_id": now.boot_id,
            "boot_s": now.boot_s,
            **columns,
        }
        return token, row

    def _compute_remaining_s(self, row: Row[Any]) -> float | None:
        if row.lifetime_s is None:
            return None
        made = Moment(row.created_s, row.boot_s, row.boot_id)
        return row.lifetime_s - made.age_s(self._read_moment())

    def _delete_ended(self, connection: Connection) -> None:
        query = select(tokens).where(tokens.c.kind == "session")
        for row in connection.execute(query).all():
            left_s = self._compute_remaining_s(row)
            if left_s is not None and left_s <= 0:
                own = tokens.c.sha256 == row.sha256
                connection.execute(delete(tokens).where(own))


def _hash(token: str) -> str:
    """A random token of 256 bits needs no salt and no slow hash."""
    return hashlib.sha256(token.encode("utf-8", "replace")).hexdigest()
