"""The process that owns the devices, and its messages to the service."""
