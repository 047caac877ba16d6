"""Truepath: the folders `app`, `drivers` and `simulators` as one package.

The links beside this file give them names that no other distribution uses.
"""
