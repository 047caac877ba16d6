"""The solution: batch, Monte Carlo trials, the budget of contributions.

Here: from normal equations to errors with covariance. Not here: tests of the solution
(`estimation.checks`), tables (`results`).
"""
