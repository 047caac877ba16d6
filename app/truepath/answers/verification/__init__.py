"""Whether a machine conforms to the prediction of its model, by ISO 14253-1.

Here: the whole verification, its file, sentences and report; `places` and `circles`
hold what is computed of each. Not here: the rows that are measured (`motion.paths`).
"""
