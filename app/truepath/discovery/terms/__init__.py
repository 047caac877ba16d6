"""Sums over lines by which thousands of candidate terms are compared quickly."""
