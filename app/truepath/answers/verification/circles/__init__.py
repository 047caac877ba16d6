"""Circular tests (ISO 230-4), at standstill and in motion.

Here: figures, their JSON and polar charts. Not here: the path of a circle
(`motion.paths`).
"""
