"""Trackers behind SpatialAnalyzer's T2SA application: lines of text over TCP.

Replies are `ACK-300 text` or `ERR-305 text`, and name no request. The dialogue is that
of a public client and its mock, ts_lasertracker of the Vera C. Rubin Observatory
(github.com/lsst-ts/ts_lasertracker: `t2sa_model.py`, `utils.py`, `enums.py`,
`mock_t2sa.py`). Not tested with T2SA or a tracker.
"""
