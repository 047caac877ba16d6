"""HTTP under `/api/v1`: routes without science or decisions.

A route (`routes`) checks its body (`models`), calls one verb of the dispatcher
(`jobs.dispatch`), of `machines` or `users`, or reads the `catalogue`, and describes the
answer for clients. Every refusal is a problem of RFC 9457; `problems.py` and the table
`problems.toml` map errors to problems. Requests that change something are safe to
repeat: an Idempotency-Key creates one job, and If-Match names the version of the job
that was read (RFC 9110, section 13). Lists are pages with an opaque cursor
(`request_parameters.py`). Events are server-sent (`routes/events.py`): stored events
are resumed from Last-Event-ID, momentary ones are dropped when a client is slow.

Before every route: limits of connections (`connections.py`), host names, cross-site
requests and proxies (`guard.py`), log-in, roles and the audit log
(`access_control.py`, `route_roles.py`). `stop` and `abort` need no version, no key and
no free worker thread. `docs/openapi.json` is the checked-in description, written by
`application.py`.
"""
