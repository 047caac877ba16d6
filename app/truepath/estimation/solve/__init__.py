"""The solution: batch, Monte Carlo, the budget of contributions."""
