"""One file of routes per resource, with the bodies that it alone uses.

Not here: roles (`route_roles.py`), texts of refusals (`problems.toml`).
"""
