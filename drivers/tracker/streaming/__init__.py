"""The streaming tracker: binary frames over serial or TCP (docs/tracker-protocol.md)."""
