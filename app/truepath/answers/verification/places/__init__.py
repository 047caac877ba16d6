"""Places measured again: deviations, lengths, and what conforms (ISO 14253)."""
