"""The page in a real browser, over a service that is played and over the real one."""
