"""What a compensation leaves of the errors, by its own tables."""
