"""The history of one machine: its calibrations, models, and what has changed.

Here: comparisons over calibrations that are stored. Not here: drift from Run to Run
(`answers.trend`), the rows of calibrations (`catalogue`).
"""
