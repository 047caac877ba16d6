"""Points measured again: deviations, lengths, and conformity (ISO 14253-1).

Here: computation alone. Not here: JSON, sentences and report, which are one folder up.
"""
