"""One maker's files each: written, and read back where that is possible.

What stands in the tables is decided in `tables`.
"""
