"""A plan as it is stored and shown.

Here: its document and report. Not here: what to measure (`truepath.planning`), the rows
to command (`motion.paths`).
"""
