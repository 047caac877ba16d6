"""Who may ask: connections, proxies, sessions, roles."""
