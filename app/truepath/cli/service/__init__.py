"""Commands that run the service or manage its data, users and computer.

Here: serve, demo, simulate, record, doctor, backup, users, keys, audit, catalogue. Not
here: their checks and actions (`operation`, `users`, `catalogue`, `main`).
"""
