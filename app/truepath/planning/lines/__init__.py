"""Which lines to measure, by their information per second.

Not here: motion times (`motion`), the criterion (`numerics.design_criteria`).
"""
