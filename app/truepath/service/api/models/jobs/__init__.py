"""Bodies of jobs, plans and their rows.

Not here: bodies that one route alone uses, which are beside it (`routes`).
"""
