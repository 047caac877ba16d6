"""Observations of lines, points and cells, made of the samples that belong to them.

How samples are cut into passes and standstills is `stream`'s.
"""
