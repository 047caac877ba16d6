"""What certificates state of a machine, beside who it is

Revision ID: 0014
Revises: 0013
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Apply."""
    stated = sa.Column("stated", sa.JSON, nullable=False, server_default="{}")
    op.add_column("machines", stated)


def downgrade() -> None:
    """Take back."""
    op.drop_column("machines", "stated")
