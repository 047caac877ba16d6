"""Migrations of the catalogue, run by Alembic when the service starts.

Here: how an older schema becomes the present one. Not here: the tables as they are now
(`catalogue.schema`).
"""
