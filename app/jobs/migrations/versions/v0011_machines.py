"""Machines, their identity and the versions of their configuration

Revision ID: 0011
Revises: 0010
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None

_TEXTS = ("name", "maker", "model", "serial_number", "control", "customer", "place")


def upgrade() -> None:
    """Apply."""
    op.add_column("jobs", sa.Column("machine_version", sa.Integer, nullable=True))
    op.create_table(
        "machines",
        sa.Column("id", sa.String(32), primary_key=True),
        sa.Column("origin", sa.String(16), nullable=False),
        *(sa.Column(text, sa.String(200), nullable=False) for text in _TEXTS),
        sa.Column("tolerance_um", sa.Float, nullable=True),
        sa.Column("reference_job", sa.String(36), nullable=True),
        sa.Column("created", sa.String(32), nullable=False),
    )
    op.create_table(
        "machine_versions",
        sa.Column("machine_id", sa.String(32), sa.ForeignKey("machines.id")),
        sa.Column("number", sa.Integer),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("machine_file", sa.JSON, nullable=False),
        sa.Column("devices", sa.JSON, nullable=False),
        sa.Column("since", sa.String(32), nullable=False),
        sa.PrimaryKeyConstraint("machine_id", "number"),
    )


def downgrade() -> None:
    """Take back."""
    op.drop_table("machine_versions")
    op.drop_table("machines")
    op.drop_column("jobs", "machine_version")
