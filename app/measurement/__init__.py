"""Doing it: recording a Run while the machine moves."""
