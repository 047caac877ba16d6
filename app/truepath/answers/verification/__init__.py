"""Whether a machine conforms to the prediction of its model, by ISO 14253-1.

Here: figures, decisions, file and report. Not here: the rows that are measured
(`motion.paths`).
"""
