"""Which machine a job is for

Revision ID: 0010
Revises: 0009
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Apply."""
    op.add_column("jobs", sa.Column("machine", sa.String(32), nullable=True))


def downgrade() -> None:
    """Take back."""
    op.drop_column("jobs", "machine")
