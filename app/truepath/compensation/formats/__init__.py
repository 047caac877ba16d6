"""Files of one maker each: written, and read back where that is possible.

Here: the syntax, units and signs of a control, with the manual they are from. Not here:
which numbers to write (`compensation.tables`), NC programs (`motion`).
"""
