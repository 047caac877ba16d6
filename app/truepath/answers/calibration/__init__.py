"""The report of one calibration, its files and the table of its points.

Here: `analyse` from bundles to files, and the sections of the report. Not here: the
numbers themselves (`results`), charts (`answers.shown`), the certificate.
"""
