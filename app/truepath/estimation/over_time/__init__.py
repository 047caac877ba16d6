"""Errors that change between Runs: drift, and growth with temperature.

Here: states over time and their fit. Not here: their presentation (`answers.trend`,
`answers.temperature`).
"""
