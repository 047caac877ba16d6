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

    The tables are those of `schema` until a revision follows: it takes a copy of them
    along, since this step has to go on making the tables that it makes today.
    """
    metadata.create_all(op.get_bind(), checkfirst=False)
