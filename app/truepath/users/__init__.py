"""Who may do what: users, their roles, sessions, API keys, and the record of it all.

Here: accounts and what they may prove. Not here: the least role of each route, and
sessions over HTTP (`service.api.security`).

A person logs in with a name and a password (argon2id) and gets a session; a program
holds an API key. Both are opaque random tokens, of which the catalogue keeps the
SHA-256 only: they are revoked by deleting a row, and nothing that is stolen from the
catalogue opens the service. Time that has passed since a token was made is read from
the clock of the boot, which no clock jump moves; only across a reboot the wall clock
counts.

The audit log is a chain: the hash of each row covers the hash of the row before, so a
row that was changed or taken out is found and named.
"""
