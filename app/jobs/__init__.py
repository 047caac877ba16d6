"""Jobs: what was asked, how far it is, what came of it, and who does it.

A job has one `state` (`transitions.py`, the only place that says what may follow what)
and one `version` that counts its changes of state. `stage` (planning, measuring,
aligning, estimating, reporting) is progress, not a second state. The catalogue
(`store.py`, `runs.py`) is the truth: a change of state, its event and its idempotency
key are one transaction, checked against the version (compare and set), so that two
operators, a retried request and a worker that comes back late cannot both win.

Threads and processes:

- a *job thread* runs `workflow.py` top to bottom and is the only one to end its job;
- the *cell thread* (`cell_supervisor.py`) is the only one to touch the cell process;
- the *lanes* of `executor.py` are processes that compute, niced below the cell process;
- request threads of `api` call the verbs of `dispatcher.py`, which wait for no motion.

After a restart nothing moves: `sweep` turns every job that had not ended into
`interrupted` and catalogues what its Run had recorded.
"""
