"""Bodies of machines, their files and conditions.

Not here: bodies that one route alone uses, which are beside it (`routes`).
"""
