"""A plan as it is stored and shown; `truepath.planning` decides what to measure."""
