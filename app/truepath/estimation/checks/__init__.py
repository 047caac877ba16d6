"""What contradicts the model: misfit, steps, disturbances, a wrong chain.

Here: tests of an estimate and of its Runs, each with what to do. Not here: the verdict
on a result (`results.verdict`), effects that explain a misfit (`discovery`).
"""
