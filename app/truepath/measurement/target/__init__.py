"""Finding the reflector, and finding it again."""
