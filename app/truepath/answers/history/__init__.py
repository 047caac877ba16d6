"""What calibrations of one machine state over the years, and what has changed."""
