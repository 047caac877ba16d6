"""The tables of the catalogue, with users, tokens and the audit log."""

from __future__ import annotations

import sqlalchemy as sa
from sqlalchemy import event

metadata = sa.MetaData()

# SQLite counts up only what is called INTEGER.
_Counter = sa.BigInteger().with_variant(sa.Integer, "sqlite")

runs = sa.Table(
    "runs",
    metadata,
    sa.Column("seq", _Counter, primary_key=True),
    sa.Column("id", sa.String(36), nullable=False, unique=True),
    sa.Column("name", sa.String(200), nullable=False),
    sa.Column("origin", sa.String(16), nullable=False),  # measured, uploaded
    sa.Column("file", sa.String(200), nullable=False),  # inside the folder of runs
    sa.Column("sha256", sa.String(64), nullable=False),
    sa.Column("bytes", sa.BigInteger, nullable=False),
    sa.Column("mode", sa.String(16), nullable=False),
    sa.Column("machine", sa.String(200), nullable=False),
    sa.Column("samples", sa.BigInteger, nullable=False),
    sa.Column("lost_samples", sa.BigInteger, nullable=False),
    sa.Column("complete", sa.Boolean, nullable=False),
    sa.Column("plan", sa.JSON, nullable=False),
    sa.Column("created", sa.String(32), nullable=False),
    sa.Column("note", sa.String(2000), nullable=True),
    sqlite_autoincrement=True,
)

jobs = sa.Table(
    "jobs",
    metadata,
    sa.Column("seq", _Counter, primary_key=True),
    sa.Column("id", sa.String(36), nullable=False, unique=True),
    sa.Column("kind", sa.String(32), nullable=False),
    sa.Column("machine", sa.String(32), nullable=True),
    sa.Column("machine_version", sa.Integer, nullable=True),
    sa.Column("state", sa.String(16), nullable=False),
    sa.Column("desired_state", sa.String(16), nullable=False),
    sa.Column("version", sa.Integer, nullable=False),
    sa.Column("stage", sa.String(16), nullable=False),
    sa.Column("run_id", sa.String(36), sa.ForeignKey("runs.id"), nullable=True),
    sa.Column("further_run_ids", sa.JSON, nullable=True),
    sa.Column("perpendicular_only", sa.Boolean, nullable=False),
    sa.Column("monte_carlo", sa.JSON, nullable=True),
    sa.Column("target_um", sa.Float, nullable=True),
    sa.Column("early_end", sa.JSON, nullable=True),
    sa.Column("verdict", sa.String(16), nullable=True),
    sa.Column("station", sa.JSON, nullable=True),
    sa.Column("on_notice", sa.String(16), nullable=True),
    sa.Column("notices", sa.JSON, nullable=True),
    sa.Column("plan", sa.JSON, nullable=True),
    sa.Column("progress", sa.JSON, nullable=False),
    sa.Column("health", sa.JSON, nullable=False),
    sa.Column("failure", sa.JSON, nullable=True),
    sa.Column("owner", sa.String(64), nullable=True),
    sa.Column("attempts", sa.Integer, nullable=True),
    sa.Column("name", sa.String(200), nullable=True),
    sa.Column("note", sa.String(2000), nullable=True),
    sa.Column("created", sa.String(32), nullable=False),
    sa.Column("started", sa.String(32), nullable=True),
    sa.Column("ended", sa.String(32), nullable=True),
    sa.Index("jobs_by_state", "state", "seq"),
    sqlite_autoincrement=True,
)

machines = sa.Table(
    "machines",
    metadata,
    sa.Column("id", sa.String(32), primary_key=True),
    sa.Column("origin", sa.String(16), nullable=False),  # settings, catalogue
    sa.Column("name", sa.String(200), nullable=False),
    sa.Column("maker", sa.String(200), nullable=False),
    sa.Column("model", sa.String(200), nullable=False),
    sa.Column("serial_number", sa.String(200), nullable=False),
    sa.Column("control", sa.String(200), nullable=False),
    sa.Column("customer", sa.String(200), nullable=False),
    sa.Column("place", sa.String(200), nullable=False),
    sa.Column("tolerance_um", sa.Float, nullable=True),
    sa.Column("reference_job", sa.String(36), nullable=True),
    sa.Column("created", sa.String(32), nullable=False),
    sa.Column("stated", sa.JSON, nullable=False, server_default="{}"),
)

machine_versions = sa.Table(
    "machine_versions",
    metadata,
    sa.Column("machine_id", sa.String(32), sa.ForeignKey("machines.id")),
    sa.Column("number", sa.Integer),
    sa.Column("sha256", sa.String(64), nullable=False),
    sa.Column("machine_file", sa.JSON, nullable=False),
    sa.Column("devices", sa.JSON, nullable=False),
    sa.Column("since", sa.String(32), nullable=False),
    sa.PrimaryKeyConstraint("machine_id", "number"),
)

events = sa.Table(
    "events",
    metadata,
    sa.Column("id", _Counter, primary_key=True),
    sa.Column("job_id", sa.String(36), sa.ForeignKey("jobs.id"), nullable=False),
    sa.Column("type", sa.String(16), nullable=False),
    sa.Column("body", sa.JSON, nullable=False),
    sa.Column("created", sa.String(32), nullable=False),
    sa.Index("events_by_job", "job_id", "id"),
    sqlite_autoincrement=True,
)

deletions = sa.Table(
    "deletions",
    metadata,
    sa.Column("kind", sa.String(8), primary_key=True),  # run, job
    sa.Column("id", sa.String(36), primary_key=True),
    sa.Column("created", sa.String(32), nullable=False),
)

idempotency_keys = sa.Table(
    "idempotency_keys",
    metadata,
    sa.Column("key", sa.String(200), primary_key=True),
    sa.Column("body_sha256", sa.String(64), nullable=False),
    sa.Column("job_id", sa.String(36), sa.ForeignKey("jobs.id"), nullable=False),
    sa.Column("created_s", sa.BigInteger, nullable=False),
)

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

_KEPT = "rows of the audit log are never changed"
_FORBID_CHANGES = {
    "sqlite": [
        f"CREATE TRIGGER audit_no_{verb.lower()} BEFORE {verb} ON audit "
        f"BEGIN SELECT RAISE(ABORT, '{_KEPT}'); END"
        for verb in ("UPDATE", "DELETE")
    ],
    "postgresql": [
        "CREATE FUNCTION audit_keep() RETURNS trigger LANGUAGE plpgsql AS "
        f"$$ BEGIN RAISE EXCEPTION '{_KEPT}'; END $$",
        "CREATE TRIGGER audit_keep BEFORE UPDATE OR DELETE ON audit "
        "FOR EACH ROW EXECUTE FUNCTION audit_keep()",
    ],
}
for _dialect, _statements in _FORBID_CHANGES.items():
    for _statement in _statements:
        _made = sa.DDL(_statement).execute_if(dialect=_dialect)
        event.listen(audit, "after_create", _made)
