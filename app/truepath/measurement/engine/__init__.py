"""The measurement itself: steps along a path or from point to point."""
