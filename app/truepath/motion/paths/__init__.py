"""Rows to command: lines, circles, corners, points, and how fast."""
