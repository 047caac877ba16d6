"""One job while it runs: measurement, live estimate, notices, resumption.

Here: state shared between threads, and messages to cell and live estimate. Not here:
the order of steps (`jobs.kinds`), the cell (`machines`).
"""
