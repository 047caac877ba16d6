"""Which devices a machine has, and how they are connected."""
