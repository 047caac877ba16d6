"""Jobs: the steps done for a request, and the process that computes each.

Here: what a job does and who runs it. Not here: the rows of jobs and their states
(`catalogue`), the cell of a machine (`machines`), science (the rooms below), HTTP
(`service`).

A job has one `state` (allowed changes: `catalogue.transitions`) and one `version` that
counts its changes of state. `stage` (planning, measuring, aligning, estimating,
reporting) is progress, not a second state. A change of state, its event and its
idempotency key are one transaction, checked against the version (compare and set). So
two operators, a repeated request and a late worker cannot both succeed.

Each kind of job is a class in `kinds`: `prepare` makes a job of a request, `run` holds
its steps from top to bottom. `dispatch.dispatcher` starts it; between stations of the
tracker (`kinds.stations`) it waits for an operator.

Threads and processes:
- the *job thread*, started by the dispatcher, runs the workflow and alone ends its job
  (`running.active_job` is what it shares with other threads);
- the *cell thread* (`machines.cell_supervisor`) alone communicates with the cell
  process;
- *worker processes* (`workers.executor`) compute, niced below the cell process;
- request threads of the interface call verbs of the dispatcher, which wait for no
  motion.

After a restart nothing moves: every measurement that had not ended becomes
`interrupted`, and what its Run had recorded is added to the catalogue
(`dispatch.reconciliation`). Jobs that only compute are queued again
(`catalogue.job_changes`).

RFC 9110 (conditional requests), section 13; draft-ietf-httpapi-idempotency-key-header.
"""
