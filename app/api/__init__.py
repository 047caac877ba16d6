"""HTTP under /api/v1; no science, no decisions."""
