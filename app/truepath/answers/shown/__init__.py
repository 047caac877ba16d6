"""Shared by all reports: numbers for people, charts, figures, the frame of a page.

Here: formatting, SVG, the Jinja2 templates of every report. Not here: what one kind of
answer alone needs; the operator page (`service.page`).
"""
