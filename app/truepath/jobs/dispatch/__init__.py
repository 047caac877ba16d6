"""Verbs of jobs, restart, deletion.

Here: what may be called from request threads, and what is done when the service starts.
Not here: the steps of a job (`jobs.kinds`), states (`catalogue.transitions`).
"""
