"""Migrations of the catalogue, run by Alembic when the service starts."""
