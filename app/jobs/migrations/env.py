"""Where Alembic starts: it is handed the service's own connection."""

from __future__ import annotations

from alembic import context

from truepath.app.jobs.schema import metadata

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=metadata,
    render_as_batch=True,
)
with context.begin_transaction():
    context.run_migrations()
