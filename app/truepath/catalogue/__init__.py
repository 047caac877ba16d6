"""The database of jobs, Runs and machines: rows, schema, file, lock, job states.

`transitions` says which state of a job may follow which; `locks` keeps a second service
out. Not here: what a job does (`jobs`), what a Run's file holds
(`measurement.run_file`), accounts and audit log (`users`).
"""
