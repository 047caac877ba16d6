"""Observations: lines and standstills, reduced to cells for the estimate.

Here: cutting a line at its steady feed, means and covariances of cells, conditions that
effects depend on (rates, reversals, temperatures). Not here: which samples belong to
which row (`alignment.stream`), the noise of observations (`estimation.noise`).
"""
