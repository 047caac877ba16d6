"""Rows to command: lines, circles, corners, points, and their feeds.

Here: paths that need no estimate, and rows of users. Not here: rows chosen for their
information (`planning`).
"""
