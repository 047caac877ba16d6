"""Drivers of trackers and machine controllers, written against `drivers.interfaces`.

`transport` moves bytes, `tracker/<make>` and `cnc/<make>` give them meaning,
`conformance` checks what every driver must keep. Nothing here knows the service.
"""
