"""The state of a result's verdict

Revision ID: 0005
Revises: 0004
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Apply."""
    op.add_column("jobs", sa.Column("verdict", sa.String(16), nullable=True))


def downgrade() -> None:
    """Take back."""
    op.drop_column("jobs", "verdict")
