"""Where to measure."""
