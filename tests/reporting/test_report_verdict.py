"""The verdict in the report: loud above everything where it is not simply usable."""

from dataclasses import replace

import pytest

from truepath.answers.calibration.calibration_report import render_calibration_report
from truepath.files.earlier.verdict import Reason, Verdict

LEFT_OUT = Reason("spikes-left-out", "usable", {"samples": 3, "distance_um": 90.0})
BEYOND = Reason("fit-beyond-noise", "not-usable", {"ratio": 3.5, "limit_ratio": 1.3})


def render(found, *reasons):
    return render_calibration_report(replace(found, verdict=Verdict(reasons)))


def test_a_result_that_is_not_to_be_used_begins_with_that(found):
    page = render(found, LEFT_OUT, BEYOND)
    band = page.index('class="verdict not-usable" role="alert"')
    assert band < page.index("<strong>Not to be used</strong>")
    assert page.index(str(BEYOND)) < page.index(str(LEFT_OUT))
    assert page.index(str(LEFT_OUT)) < page.index('class="tile ')
    assert f'class="grave">{BEYOND}' in page


def test_what_was_left_out_of_a_usable_result_is_listed_quietly(found):
    page = render(found, LEFT_OUT)
    assert 'class="verdict usable" role="note"' in page
    assert str(LEFT_OUT) in page
    assert 'class="grave"' not in page


@pytest.mark.parametrize("text", ["<script>alert(1)</script>"])
def test_a_reason_from_outside_is_escaped(found, text):
    assert text not in render(found, Reason("stated", "doubtful", {"text": text}))


def test_a_result_with_nothing_to_say_has_no_band(found):
    assert 'class="verdict' not in render(found)
