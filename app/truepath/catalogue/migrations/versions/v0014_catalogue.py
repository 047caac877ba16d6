"""The catalogue, all of it

Revision ID: 0014
Revises:
"""

from __future__ import annotations

from alembic import op

from truepath.catalogue.schema import metadata

revision = "0014"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Apply.

    The tables are those of `schema` until a revision follows: it then needs a copy of
    them here, since this step has to make the same tables for ever.
    """
    metadata.create_all(op.get_bind(), checkfirst=False)
