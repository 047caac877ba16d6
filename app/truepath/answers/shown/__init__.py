"""Shared by all reports: numbers for people, charts, figures, the frame of a page."""
