"""Trackers whose software sends lines of text.

layout      fields of a line; lines to samples
line_order  lines that come out of order
driver      start, read, stop over serial, TCP or UDP
"""
