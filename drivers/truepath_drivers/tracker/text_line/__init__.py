"""Trackers whose software sends lines of text.

layout  fields of a line; lines to samples
driver  start, read, stop over serial, TCP or UDP; order and pace of lines
"""
