"""The target uncertainty of a job and how it ended early

Revision ID: 0002
Revises: 0001
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Apply. Targets that stood in the plan move to a column of their own."""
    op.add_column("jobs", sa.Column("target_um", sa.Float(), nullable=True))
    op.add_column("jobs", sa.Column("early_end", sa.JSON(), nullable=True))
    jobs = sa.table(
        "jobs",
        sa.column("seq", sa.Integer()),
        sa.column("plan", sa.JSON()),
        sa.column("target_um", sa.Float()),
    )
    connection = op.get_bind()
    for seq, plan in connection.execute(sa.select(jobs.c.seq, jobs.c.plan)).all():
        if plan and plan.get("target_um") is not None:
            values = {"target_um": plan["target_um"]}
            connection.execute(sa.update(jobs).where(jobs.c.seq == seq).values(values))


def downgrade() -> None:
    """Take back."""
    for name in ("early_end", "target_um"):
        op.drop_column("jobs", name)
