"""Othermake's laser tracker LT-50 and control C7 for Truepath."""
