"""The operator page; no science, no decisions."""
