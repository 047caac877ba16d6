"""Trackers, one folder a make; `line_instrument` is shared by those that are polled.

Here: live trackers. A recording that other software has exported is read by
`truepath.files.imports`.
"""
