"""What must hold before a machine may move: required state, and reason if not.

Here: levels, read whenever asked. Not here: faults during motion
(`measurement.faults`), arm tokens (`jobs.dispatch`).
"""
