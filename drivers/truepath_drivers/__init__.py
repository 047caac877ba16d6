"""Drivers of trackers and machine controllers, written against `interfaces`.

`transport` moves bytes, `streams` numbers, orders and feeds what they carry,
`tracker/<make>` and `cnc/<make>` interpret it, `conformance` checks requirements on
every driver. Nothing here knows the service; it finds drivers by their entry points.
Recorded text of other software is read by `truepath.files.imports`.
"""
