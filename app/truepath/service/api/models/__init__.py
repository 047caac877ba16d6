"""Bodies of requests and answers that several routes share, and those of files.

Keys name their unit; readers take further keys. Not here: bodies of one route, which
are beside it (`routes`).
"""
