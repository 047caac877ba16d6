"""Rows to command: lines, circles, corners, points, and at which feed.

Here: paths that need no estimate, and rows of users. Not here: rows chosen for what
they determine (`planning.lines`).
"""
