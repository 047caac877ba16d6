"""Trackers, one folder per make; `line_instrument` is shared by polled ones.

Here: live trackers. A recording that other software has exported is read by
`truepath.files.imports`.
"""
