"""HTTP: the interface (`api`) and the operator's page (`page`).

Not here: decisions and computations; a Python client is `truepath.client`.
"""
