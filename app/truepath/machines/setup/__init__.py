"""Which devices a machine has, from settings or the page, and how they connect.

Not here: settings as they are read (`machine_settings`), options of drivers
(`device_options`).
"""
