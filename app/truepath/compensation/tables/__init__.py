"""The map of errors as the tables that a control can hold, in no maker's format."""
