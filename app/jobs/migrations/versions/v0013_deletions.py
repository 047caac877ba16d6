"""What has been deleted, until its files have gone

Revision ID: 0013
Revises: 0012
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0012"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Apply."""
    op.create_table(
        "deletions",
        sa.Column("kind", sa.String(8), primary_key=True),
        sa.Column("id", sa.String(36), primary_key=True),
        sa.Column("created", sa.String(32), nullable=False),
    )


def downgrade() -> None:
    """Take back."""
    op.drop_table("deletions")
