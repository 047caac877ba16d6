"""Lets the tests of faults use what is beside them."""
