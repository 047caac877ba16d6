"""HTTP: the interface (`api`) and the operator's page (`page`).

Requests in, answers out. Not here: anything that is decided or computed; a client in
Python is `truepath.client`.
"""
