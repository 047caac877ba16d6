"""What must hold before a machine may move: required state, and reason if not.

Here: levels, read on every request. Not here: faults during motion
(`measurement.faults`), arm tokens (`jobs.dispatch`).
"""
