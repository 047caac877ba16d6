"""Access: connections, proxies, host names, sessions, roles.

Not here: accounts, keys and passwords (`users`).
"""
