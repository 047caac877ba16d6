"""Jobs: what was asked, how far it is, what came of it, and which process computes it.

A job has one `state` (`transitions.py` alone says which state may follow which) and one
`version` that counts its changes of state. `stage` (planning, measuring, aligning,
estimating, reporting) is progress, not a second state. The catalogue (`store.py`,
`runs.py`) is the truth: a change of state, its event and its idempotency key are one
transaction, checked against the version (compare and set). So two operators, a repeated
request and a late worker cannot both succeed.

A request becomes a job in `requested_job.py`, `dispatcher.py` starts it, `workflow.py`
says what it does from top to bottom, step by step, and how it ended; between stations
of the tracker (`station_steps.py`) it waits for a person.

Threads and processes:

- the *job thread*, started by `dispatcher.py`, runs `workflow.py` and alone ends its
  job (`active_job.py` is what it shares with other threads);
- the *cell thread* (`cell_supervisor.py`) alone speaks to the cell process;
- *worker processes* (`executor.py`) compute, niced below the cell process;
- request threads of `api` call the verbs of `dispatcher.py`, which wait for no motion.

After a restart nothing moves: every measurement that had not ended becomes
`interrupted`, and what its Run had recorded is added to the catalogue
(`reconciliation.py`, which goes on looking for Runs that no row names). Jobs that only
compute are queued again (`job_changes.py`).

RFC 9110 (conditional requests), section 13; draft-ietf-httpapi-idempotency-key-header.
"""
