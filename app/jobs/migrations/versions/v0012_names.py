"""Names of jobs, notes of jobs and Runs

Revision ID: 0012
Revises: 0011
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Apply."""
    op.add_column("jobs", sa.Column("name", sa.String(200), nullable=True))
    op.add_column("jobs", sa.Column("note", sa.String(2000), nullable=True))
    op.add_column("runs", sa.Column("note", sa.String(2000), nullable=True))


def downgrade() -> None:
    """Take back."""
    op.drop_column("runs", "note")
    op.drop_column("jobs", "note")
    op.drop_column("jobs", "name")
