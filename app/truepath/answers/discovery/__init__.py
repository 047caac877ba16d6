"""Findings of a discovery: as JSON, as an extended model file, as a report.

Here: discovery from Runs to documents. Not here: the search (`truepath.discovery`), how
a model file is read (`files.earlier`).
"""
