"""Bodies of results: estimate, discovery, trend, verification.

Not here: bodies that one route alone uses, which are beside it (`routes`).
"""
