"""The estimate while the machine moves, from checked parts of the Run."""
