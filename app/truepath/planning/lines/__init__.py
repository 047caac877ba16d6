"""Which lines to drive, by what they determine per second.

Not here: motion times (`motion`), the criterion (`numerics.design_criteria`).
"""
