"""Bodies of what was found."""
