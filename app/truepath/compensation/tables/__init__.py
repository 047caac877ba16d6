"""The map of errors as the tables that a control can hold, in no maker's format.

Here: spacing, combination with active tables, rotary axes, tool length. Not here: text
of files (`compensation.formats`), error tables of a result (`results`).
"""
