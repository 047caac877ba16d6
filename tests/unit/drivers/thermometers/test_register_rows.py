"""Rows of a register list: how words become values, and rows that cannot be."""

import pytest

from truepath_drivers.thermometers.modbus_registers import driver


@pytest.mark.parametrize(
    ("words", "options", "value"),
    [
        ([0xFF38], {"type": "int16"}, -20.0),
        ([0x00D7], {"type": "uint16"}, 21.5),
        ([0xFFFF, 0xFF38], {"type": "int32"}, -20.0),
        ([0x00D7, 0x0000], {"type": "uint32", "word_order": "little"}, 21.5),
        ([0x4357, 0x0000], {"type": "float32"}, 21.5),
        ([0x0000, 0x4357], {"type": "float32", "word_order": "little"}, 21.5),
        ([29315], {"scale": 0.01, "offset": -273.15}, 20.0),  # of kelvin
        ([680], {"scale": 0.1 / 1.8, "offset": -32 / 1.8}, 20.0),  # of Fahrenheit
    ],
)
def test_words_are_decoded(words, options, value):
    row = driver.Register("X_degC", 0, **{"scale": 0.1, **options})
    assert row.decode(words) == pytest.approx(value)


GOOD_ROW = {"name": "X_degC", "address": 0}
WRONG = [
    *({"name": "temperature"}, {"address": 65535, "type": "float32"}, {"addres": 0}),
    *({"type": "int64"}, {"function": "coil"}, {"scale": 0.0}, {"period_s": 0.0}),
    {"low": 50.0, "high": 10.0},
]
ALONE = [[GOOD_ROW | wrong] for wrong in WRONG]


@pytest.mark.parametrize(
    "rows", [*ALONE, [{"name": "X_degC"}], [], [GOOD_ROW, GOOD_ROW]]
)
def test_rows_that_cannot_be_are_refused(rows):
    with pytest.raises(ValueError, match=r"register|channel|each name once"):
        driver.ModbusRegisters(host="127.0.0.1", registers=rows)
