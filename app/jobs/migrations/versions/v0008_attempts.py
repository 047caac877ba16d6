"""How often a job was begun

Revision ID: 0008
Revises: 0007
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Apply."""
    op.add_column("jobs", sa.Column("attempts", sa.Integer(), nullable=True))


def downgrade() -> None:
    """Take back."""
    op.drop_column("jobs", "attempts")
