"""Lengths hold at the machine's own temperature, and files say so."""

from __future__ import annotations

from dataclasses import replace

import pytest

from truepath.compensation.export import export_result
from truepath.compensation.tables.error_map import map_errors
from truepath.compensation.tables.length_reference import (
    find_measured_degc,
    warn_of_lengths,
)


def test_sensors_of_the_scales_count_where_there_are_any():
    air = {"air": [18.0, 25.0], "spindle": [30.0, 31.0]}
    assert find_measured_degc({"temperature_degC": air}) == (18.0, 31.0)
    scales = {"X": [22.0, 22.5], "Y": [21.5, 22.0]}
    assert find_measured_degc({"temperature_degC": air | scales}) == (21.5, 22.5)
    assert find_measured_degc({}) is None


@pytest.mark.parametrize("ends", [(20.0, 20.0), (19.0, 21.0), (20.4, 20.9)])
def test_within_a_kelvin_of_20_degrees_nobody_is_warned(ends):
    assert warn_of_lengths(ends) is None


def test_else_the_warning_says_by_how_much_steel_is_off():
    assert "+4.0 K off 20 °C" in (warn_of_lengths((21.0, 24.0)) or "")
    assert "46 µm/m" in (warn_of_lengths((21.0, 24.0)) or "")
    assert "-2.0 K off" in (warn_of_lengths((18.0, 20.0)) or "")
    assert "not known" in (warn_of_lengths(None) or "")


def test_account_and_comments_say_it_and_no_number_changes(loaded):
    provenance = {"temperature_degC": {"X": [23.0, 23.4]}}
    exports = [
        export_result(map_errors(replace(loaded, provenance=one)), "csv", "c")
        for one in (provenance, {})
    ]
    for export in exports:
        said = f"# {export.account['lengths']['text']}"
        assert said in export.files["c.csv"].splitlines()
    warm, unknown = (export.account for export in exports)
    lengths = warm["lengths"]
    assert lengths["measured_degC"] == [23.0, 23.4]
    assert "23.0 to 23.4 degC, not normalised to 20 degC" in lengths["text"]
    assert "+3.4 K" in lengths["warning"]
    assert "unknown temperature" in unknown["lengths"]["text"]
    assert warm["volumetric_error_um"] == unknown["volumetric_error_um"]
