"""Commands that run the service or look after its data, its users and its computer.

Here: serve, demo, simulate, record, doctor, backup, users, keys, audit, catalogue. Not
here: what they check and do (`operation`, `users`, `catalogue`, `main`).
"""
