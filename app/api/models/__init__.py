"""Bodies of requests and answers, a resource a file.

Keys name their unit; readers take further keys.
"""
