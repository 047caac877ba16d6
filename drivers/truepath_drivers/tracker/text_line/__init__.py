"""Trackers whose software sends lines of text.

layout    what the fields of a line are; lines to samples
driver    start, read, stop over serial, TCP or UDP
"""
