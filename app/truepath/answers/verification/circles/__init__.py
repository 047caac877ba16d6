"""Circular tests (ISO 230-4), at standstill and in motion."""
