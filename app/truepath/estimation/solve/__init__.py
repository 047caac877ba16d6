"""The solution: batch, Monte Carlo trials, budget, drift, growth with temperature.

Here: from normal equations to errors with covariance, constant or over time. Not here:
tests of the solution (`estimation.checks`), tables (`results`), the presentation of
trends (`answers`).
"""
