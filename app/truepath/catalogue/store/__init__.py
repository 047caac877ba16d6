"""Rows of jobs and events read and written, each change in one transaction.

Here: connections (SQLite, PostgreSQL), compare-and-set of versions, idempotency keys.
Not here: Runs, machines and calibrations, one file each in `catalogue`.
"""
