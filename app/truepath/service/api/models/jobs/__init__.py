"""Bodies of jobs, plans and their rows."""
