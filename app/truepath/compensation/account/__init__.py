"""Errors that remain after compensation, from its own tables.

Here: the remaining error with its uncertainty, rotary axes included. Not here: the
tables (`compensation.tables`), how a control applies them (`truepath_simulators`).
"""
