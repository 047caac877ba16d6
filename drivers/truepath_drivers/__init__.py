"""Drivers of trackers and machine controllers, written against `interfaces`.

`transport` moves bytes, `tracker/<make>` and `cnc/<make>` give them meaning,
`conformance` checks what every driver must keep. Nothing here knows the service; it
finds drivers by their entry points. Recorded text of other software is read by
`truepath.files.imports`.
"""
