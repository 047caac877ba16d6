"""Tables of the catalogue. Migrations make them; a test holds the two together."""

from __future__ import annotations

from sqlalchemy import (
    JSON,
    BigInteger,
    Boolean,
    Column,
    Float,
    ForeignKey,
    Index,
    Integer,
    MetaData,
    String,
    Table,
)

metadata = MetaData()

# SQLite counts up only what is called INTEGER.
_Counter = BigInteger().with_variant(Integer, "sqlite")

runs = Table(
    "runs",
    metadata,
    Column("seq", _Counter, primary_key=True),
    Column("id", String(36), nullable=False, unique=True),
    Column("name", String(200), nullable=False),
    Column("origin", String(16), nullable=False),  # measured, uploaded
    Column("file", String(200), nullable=False),  # inside the folder of runs
    Column("sha256", String(64), nullable=False),
    Column("bytes", BigInteger, nullable=False),
    Column("mode", String(16), nullable=False),
    Column("machine", String(200), nullable=False),
    Column("samples", BigInteger, nullable=False),
    Column("lost_samples", BigInteger, nullable=False),
    Column("complete", Boolean, nullable=False),
    Column("plan", JSON, nullable=False),
    Column("created", String(32), nullable=False),
    sqlite_autoincrement=True,
)

jobs = Table(
    "jobs",
    metadata,
    Column("seq", _Counter, primary_key=True),
    Column("id", String(36), nullable=False, unique=True),
    Column("kind", String(32), nullable=False),
    Column("state", String(16), nullable=False),
    Column("desired_state", String(16), nullable=False),
    Column("version", Integer, nullable=False),
    Column("stage", String(16), nullable=False),
    Column("run_id", String(36), ForeignKey("runs.id"), nullable=True),
    Column("further_run_ids", JSON, nullable=True),
    Column("perpendicular_only", Boolean, nullable=False),
    Column("monte_carlo", JSON, nullable=True),
    Column("target_um", Float, nullable=True),
    Column("early_end", JSON, nullable=True),
    Column("plan", JSON, nullable=True),
    Column("progress", JSON, nullable=False),
    Column("health", JSON, nullable=False),
    Column("failure", JSON, nullable=True),
    Column("created", String(32), nullable=False),
    Column("started", String(32), nullable=True),
    Column("ended", String(32), nullable=True),
    Index("jobs_by_state", "state", "seq"),
    sqlite_autoincrement=True,
)

events = Table(
    "events",
    metadata,
    Column("id", _Counter, primary_key=True),
    Column("job_id", String(36), ForeignKey("jobs.id"), nullable=False),
    Column("type", String(16), nullable=False),
    Column("body", JSON, nullable=False),
    Column("created", String(32), nullable=False),
    Index("events_by_job", "job_id", "id"),
    sqlite_autoincrement=True,
)

idempotency_keys = Table(
    "idempotency_keys",
    metadata,
    Column("key", String(200), primary_key=True),
    Column("body_sha256", String(64), nullable=False),
    Column("job_id", String(36), ForeignKey("jobs.id"), nullable=False),
    Column("created_s", BigInteger, nullable=False),
)
