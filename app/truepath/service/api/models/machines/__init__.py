"""Bodies of machines, their files and conditions."""
