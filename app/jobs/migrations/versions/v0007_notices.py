"""What the live estimate has noticed, and what is done then

Revision ID: 0007
Revises: 0006
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Apply."""
    op.add_column("jobs", sa.Column("on_notice", sa.String(16), nullable=True))
    op.add_column("jobs", sa.Column("notices", sa.JSON(), nullable=True))


def downgrade() -> None:
    """Take back."""
    op.drop_column("jobs", "notices")
    op.drop_column("jobs", "on_notice")
