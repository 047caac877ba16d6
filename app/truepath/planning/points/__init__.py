"""Which points to stand at."""
