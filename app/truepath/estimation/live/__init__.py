"""The estimate while the machine moves.

Here: gate of new lines, tables after each line. Not here: its process and messages
(`jobs.running`).
"""
