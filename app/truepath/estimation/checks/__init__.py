"""Contradictions of the model: lack of fit, steps, disturbances, a wrong chain.

Here: tests of an estimate and of its Runs, each with a remedy. Not here: the verdict on
a result (`results.verdict`), effects that explain a lack of fit (`discovery`).
"""
