"""Which lines to drive."""
