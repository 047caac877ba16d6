"""Drivers of trackers and machine controllers, written against `interfaces`.

`transport` moves bytes, `tracker/<make>` and `cnc/<make>` interpret them, `helpers`
number, order and feed for any driver, `conformance` checks requirements on every one.
Nothing here knows the service; it finds drivers by their entry points. Recorded text of
other software is read by `truepath.files.imports`.
"""
