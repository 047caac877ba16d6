"""Trackers behind SpatialAnalyzer's T2SA application: lines of text over TCP.

The dialogue is that of a public client and its mock, ts_lasertracker of the Vera C.
Rubin Observatory (github.com/lsst-ts/ts_lasertracker). Not tested with T2SA or a
tracker.
"""
