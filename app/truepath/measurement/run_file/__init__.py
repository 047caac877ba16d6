"""The Run on disk: recorded, loaded, repaired.

Here: its SQLite file. Not here: the bundle for other programs (`files.bundle`), the
catalogue's row (`catalogue.runs`).
"""
