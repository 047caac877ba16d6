"""One file of routes per resource, with the bodies that it alone uses.

Not here: roles (`security.route_roles`), texts of refusals (`problems.toml`).
"""
