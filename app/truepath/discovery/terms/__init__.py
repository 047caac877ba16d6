"""Sums over lines by which thousands of candidate terms are compared quickly.

Here: blocks of lines, folds of held-out lines, the design of lines that decide. Not
here: which terms are tried and kept (`discovery.term_search`).
"""
