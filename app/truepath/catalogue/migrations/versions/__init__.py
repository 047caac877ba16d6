"""One file a step, in order; the first makes schema 0014, older ones are refused.

A later step stays behind it and names it as `down_revision`.
"""
