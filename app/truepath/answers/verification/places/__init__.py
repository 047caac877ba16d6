"""Points measured again: deviations, lengths, and what conforms (ISO 14253-1).

Here: computation alone. Not here: JSON, sentences and report, which are one folder up.
"""
