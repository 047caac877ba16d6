"""Truepath: the folders `app`, `drivers` and `simulators` as one package.

The links beside this file give them names that no other distribution uses. `client` is
no link: it is for other programs, which know the package by this name only.
"""
