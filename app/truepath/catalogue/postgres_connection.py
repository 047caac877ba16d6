"""Connections to PostgreSQL with limited waits. The only place with psycopg.

A frozen server, or a network that drops packets, closes no connection: only a limit of
our own ends the wait. Such a connection is closed, as its state is unknown.
"""

from __future__ import annotations

from typing import Any

import psycopg
from psycopg.abc import RV, PQGen
from sqlalchemy import Connection, Engine, event

CONNECT_S = 2
"""The least that the client library takes."""
ANSWER_S = 5.0
MIGRATION_S = 3600.0
"""A change of schema may have to write every row anew."""


def limit_waits(engine: Engine) -> None:
    """Let every connection of an engine, and every answer on it, fail in time."""

    @event.listens_for(engine, "do_connect")
    def connect(
        _dialect: Any, _record: Any, arguments: list[Any], named: dict[str, Any]
    ) -> _PatientConnection:
        named.setdefault("connect_timeout", CONNECT_S)
        return _PatientConnection.connect(*arguments, **named)


def wait_for_migration(connection: Connection) -> None:
    """Give the answers on one connection the time that a change of schema takes."""
    raw = connection.connection.dbapi_connection
    if isinstance(raw, _PatientConnection):
        raw.answer_s = MIGRATION_S


class _PatientConnection(psycopg.Connection[Any]):
    """Raises OperationalError where an answer is not there after `answer_s`."""

    answer_s = ANSWER_S

    def wait(
        self, gen: PQGen[RV], interval: float = 0.1, timeout: float | None = None
    ) -> RV:
        limit_s = self.answer_s if timeout is None else timeout
        try:
            return super().wait(gen, interval, limit_s)
        except psycopg.errors._WaitTimeout as error:  # noqa: SLF001 (has no other name)
            self.pgconn.finish()
            text = f"PostgreSQL has not answered for {limit_s:g} s"
            raise psycopg.OperationalError(text) from error
