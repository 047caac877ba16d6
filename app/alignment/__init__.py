"""One Run to observations."""
