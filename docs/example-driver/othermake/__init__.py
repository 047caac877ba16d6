"""Othermake's laser tracker LT-50 for Truepath."""
