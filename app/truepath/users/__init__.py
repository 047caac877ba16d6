"""Users, their roles, sessions and API keys, and the record of their actions.

Here: accounts and their credentials. Not here: the least role of each route, and
sessions over HTTP (`service.api`).

A person logs in with a name and a password (argon2id) and gets a session; a program
holds an API key. Both are opaque random tokens, of which the catalogue stores the
SHA-256 only: they are revoked by deleting a row, and nothing that is stolen from the
catalogue opens the service. The age of a token is read from the clock of the boot,
which no clock jump moves; only across a reboot the wall clock counts.

The audit log is a chain: the hash of each row covers the hash of the row before, so a
row that was changed or removed is found and named.
"""
