"""Errors that change between Runs: drift, and growth with temperature.

Here: states over time and their fit. Not here: what is shown of them (`answers.trend`,
`answers.temperature`).
"""
