"""Mathematics with no machine in it."""
