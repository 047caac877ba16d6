"""Trackers whose software sends lines of text.

layout    what the fields of a line are; lines to samples
pace      the clock of a stream against the one of this computer
driver    start, read, stop over serial, TCP or UDP
"""
