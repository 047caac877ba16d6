"""Tables of users, tokens and the audit log, beside those of the catalogue."""

from __future__ import annotations

import sqlalchemy as sa

from truepath.app.jobs.schema import metadata

users = sa.Table(
    "users",
    metadata,
    sa.Column("name", sa.String(64), primary_key=True),
    sa.Column("role", sa.String(16), nullable=False),
    sa.Column("password_hash", sa.String(200), nullable=False),
    sa.Column("created", sa.String(32), nullable=False),
)

tokens = sa.Table(
    "tokens",
    metadata,
    sa.Column("sha256", sa.String(64), primary_key=True),
    sa.Column("kind", sa.String(16), nullable=False),  # session, key
    sa.Column("name", sa.String(64), nullable=False),  # of the user, of the key
    sa.Column("role", sa.String(16), nullable=True),  # of a key
    sa.Column("created", sa.String(32), nullable=False),
    sa.Column("created_s", sa.Float, nullable=False),
    sa.Column("boot_id", sa.String(64), nullable=False),
    sa.Column("boot_s", sa.Float, nullable=False),
    sa.Column("lifetime_s", sa.Float, nullable=True),
    sa.Index("tokens_by_name", "kind", "name"),
)

audit = sa.Table(
    "audit",
    metadata,
    sa.Column("seq", sa.BigInteger, primary_key=True, autoincrement=False),
    sa.Column("at", sa.String(32), nullable=False),
    sa.Column("who", sa.String(64), nullable=False),
    sa.Column("role", sa.String(16), nullable=False),
    sa.Column("source", sa.String(64), nullable=False),
    sa.Column("request_id", sa.String(64), nullable=False),
    sa.Column("what", sa.String(400), nullable=False),
    sa.Column("outcome", sa.String(32), nullable=False),
    sa.Column("old", sa.JSON, nullable=True),
    sa.Column("new", sa.JSON, nullable=True),
    sa.Column("hash", sa.String(64), nullable=False),
)

audit_head = sa.Table(
    "audit_head",
    metadata,
    sa.Column("id", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("seq", sa.BigInteger, nullable=False),
    sa.Column("hash", sa.String(64), nullable=False),
)
"""One row: the newest row of the audit log, so that none is cut off its end."""
