"""Commands that compute from files: analyse, predict, discover, plan, verify, trend.

Here: their options, progress and output, also of import, grade, temperature and
reanalyse. Not here: any computation, or commands for a running service.
"""
