"""One file of routes a resource, with the bodies that it alone uses.

Not here: roles (`security.route_roles`), texts of refusals (`problems.toml`).
"""
