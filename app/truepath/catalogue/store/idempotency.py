"""Idempotency keys: a request that comes twice makes one job."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

from sqlalchemy import Connection, delete, insert, select

from truepath.catalogue.errors import KeyReused
from truepath.catalogue.job import Job
from truepath.catalogue.schema import idempotency_keys
from truepath.catalogue.store.job_rows import read_job
from truepath_drivers import host_clock

KEEP_KEYS_S = 24 * 3600


@dataclass(frozen=True, slots=True)
class IdempotencyKey:
    """An Idempotency-Key, the body it came with, and its owner.

    owner : name of the user; None where there is no login
    """

    value: str
    body: bytes
    owner: str | None = None

    @property
    def kept(self) -> str:
        """The stored form, separate by owner: two users may choose the same key."""
        if self.owner is None:
            return self.value
        return hashlib.sha256(f"{self.owner} {self.value}".encode()).hexdigest()

    @property
    def body_sha256(self) -> str:
        """Digest by which a repeated body is recognised."""
        return hashlib.sha256(self.body).hexdigest()


def find_job_by_key(connection: Connection, key: IdempotencyKey) -> Job | None:
    """None if the key has made no job in 24 h. Raises KeyReused."""
    is_own = idempotency_keys.c.key == key.kept
    is_young = idempotency_keys.c.created_s >= _find_oldest_s()
    query = select(idempotency_keys).where(is_own & is_young)
    row = connection.execute(query).mappings().first()
    if row is None:
        return None
    if row["body_sha256"] != key.body_sha256:
        raise KeyReused(
            f"Idempotency-Key {key.value!r} has made job {row['job_id']} from another "
            "body; use a new key for a new job"
        )
    return read_job(connection, row["job_id"])


def insert_key(connection: Connection, key: IdempotencyKey, job_id: str) -> None:
    """Record which job a key has made."""
    of_before = idempotency_keys.c.key == key.kept
    connection.execute(delete(idempotency_keys).where(of_before))
    row = {"key": key.kept, "body_sha256": key.body_sha256, "job_id": job_id}
    query = insert(idempotency_keys).values(**row, created_s=int(host_clock.wall_s()))
    connection.execute(query)


def delete_old_keys(connection: Connection) -> None:
    """Delete the keys older than `KEEP_KEYS_S`."""
    old = idempotency_keys.c.created_s < _find_oldest_s()
    connection.execute(delete(idempotency_keys).where(old))


def _find_oldest_s() -> int:
    return int(host_clock.wall_s()) - KEEP_KEYS_S
