"""What an earlier analysis found and a later one reads: results, models, verdicts.

Here: readers of our own files. Not here: their writers, which are with what they state
(`results`, `answers`).
"""
