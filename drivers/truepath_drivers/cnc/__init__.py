"""Machine controllers, one folder a make."""
