"""Results of an earlier analysis for a later one: results, models, verdicts.

Here: readers of our own files. Not here: their writers, which are with the content
(`results`, `answers`).
"""
