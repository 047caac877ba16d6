"""What every driver keeps, as checks that any author can run against a device.

A check takes a factory that makes a fresh driver, not connected, for a device that
answers; it returns nothing, or raises NotConforming, which says what was not kept. With
pytest:

    from truepath_drivers.conformance.tracker import TRACKER_CHECKS

    @pytest.mark.parametrize("check", TRACKER_CHECKS, ids=lambda check: check.__name__)
    def test_my_tracker_conforms(check):
        check(lambda: MyTracker(port="/dev/ttyUSB0"))

The checks of motion controllers MOVE THE AXES, by `REACH` mm or deg at `FEED_MM_MIN`
from where they stand towards the middle of the travel: clear the machine first.
"""
