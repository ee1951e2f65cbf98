"""Alembic's environment: the caller hands in its connection, with its transaction."""

from __future__ import annotations

from alembic import context

from daq_service.catalogue.tables import metadata

context.configure(
    connection=context.config.attributes["connection"], target_metadata=metadata, render_as_batch=True
)
with context.begin_transaction():
    context.run_migrations()
