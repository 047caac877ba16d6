"""From a request to a job, and its steps from top to bottom.

Here: what a job does, and in which order. Not here: monitoring of a measurement
(`jobs.running`), tasks of worker processes (`jobs.workers`).
"""
