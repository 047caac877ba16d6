"""Requirements on every driver, as checks that any author can run against a device.

A check takes a factory that makes a fresh, unconnected driver for a device that
answers; it raises NotConforming, whose text names the violated requirement. With
pytest:

    from truepath_drivers.conformance.tracker import TRACKER_CHECKS

    @pytest.mark.parametrize("check", TRACKER_CHECKS, ids=lambda check: check.__name__)
    def test_my_tracker_conforms(check):
        check(lambda: MyTracker(port="/dev/ttyUSB0"))

The checks of motion controllers MOVE THE AXES, by `REACH` mm or deg at `FEED_MM_MIN`
from where they are towards the middle of the travel: clear the machine first.
"""
