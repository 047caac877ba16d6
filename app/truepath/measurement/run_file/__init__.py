"""The Run on disk: recorded, read back, repaired."""
