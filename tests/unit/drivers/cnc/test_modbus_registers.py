"""The register map as data: no overlap, known words, a page that agrees with it."""

import itertools
import runpy
import struct
import zlib
from dataclasses import replace
from pathlib import Path as File

import pytest
from hypothesis import given
from hypothesis import strategies as st

from paths_by_hand import path_of
from truepath_drivers.cnc.modbus import map_records as maps
from truepath_drivers.cnc.modbus import registers as r
from truepath_drivers.cnc.modbus.commands import FIRST_S, LONGEST_S, BackOff
from truepath_drivers.interfaces import errors, records

BLOCKS = r.IDENTITY, r.STATUS, r.READINESS, r.ALARM_TEXT, r.CONTROL, r.LIMITS, r.COMMAND
DOCS = File(__file__).parents[4] / "docs"


def test_registers_are_in_order_each_in_one_block_that_fits_into_a_request():
    assert all(block.count <= 123 for block in BLOCKS)
    for before, after in itertools.pairwise(r.REGISTERS):
        assert before.end <= after.address
    for register in r.REGISTERS:
        spans = [(block.address, block.address + block.count) for block in BLOCKS]
        homes = [a <= register.address and register.end <= b for a, b in spans]
        assert sum(homes) == 1, register.name
        # The host writes only control and command.
        assert (register.access is r.Access.WRITE) == (register.address >= 180)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("magic", r.MAGIC, [0x5450, 0x4331]),
        ("order_test", 0x01020304, [0x0102, 0x0304]),
        ("state", 3, [3]),
        ("travel_min", [-1, 6_100_000], [0xFFFF, 0xFFFF, 0x005D, 0x1420] + [0] * 8),
        ("maker", "AB c", [0x4142, 0x2063] + [0] * 6),
        ("axis_names", [ord("X"), ord("Z")], [0x58, 0x5A, 0, 0, 0, 0]),
    ],
)
def test_words_of_known_values(name, value, words):
    assert maps.encode(name, value) == words


@given(st.lists(st.integers(-(2**31), 2**31 - 1), min_size=6, max_size=6))
def test_positions_come_back(counts):
    words = [0] * 12 + maps.encode("position", counts)
    assert maps.decode("position", words, r.STATUS) == tuple(counts)


@given(st.text("ABCü xyz-09", max_size=16))
def test_texts_come_back_without_padding_and_a_question_mark_for_what_is_no_ascii(text):
    words = [0] * 20 + maps.encode("maker", text)
    assert maps.decode_text("maker", words, r.IDENTITY) == text.strip().replace(
        "ü", "?"
    )


def test_rows_are_big_endian_counts():
    rows = (1.23456, -2.0, 300.0), (0.0, 0.0, -0.00006)
    path = path_of(*rows, feed=(2500.0, 15000.5), dwell_s=(0.0, 1.5))
    words = maps.path_words(path)
    first = struct.pack(">6i2I", 12346, -20000, 3_000_000, 0, 0, 0, 2_500_000, 0)
    second = struct.pack(">6i2I", 0, 0, -1, 0, 0, 0, 15_000_500, 1500)
    assert words.astype(">u2").tobytes() == first + second
    assert maps.path_crc(words) == zlib.crc32(first + second)


def test_hold_reasons_read_as_words_unknown_ones_as_numbers_and_no_state_as_wrong():
    def reason(code):
        words = [0] * 24
        words[:2] = [r.STATES.index(records.MotionState.HELD), code]
        return maps.parse_status(words).motion.hold_reason

    words = [reason(code) for code in (0, 1, 2, 3, 9)]
    assert words == ["", "operator", "watchdog", "command", "reason 9"]
    with pytest.raises(errors.WrongDevice, match="reports state 99"):
        maps.parse_status([99] + [0] * 23)


@pytest.mark.parametrize(
    ("features", "bits", "said"),
    [
        (0, 3, (None, None)),
        (r.TELLS_REFERENCED, 0, (False, None)),
        (r.TELLS_REFERENCED, r.IS_REFERENCED | r.IS_COMPENSATING, (True, None)),
        (r.TELLS_COMPENSATION, r.IS_COMPENSATING, (None, True)),
        (r.TELLS_REFERENCED | r.TELLS_COMPENSATION, r.IS_REFERENCED, (True, False)),
    ],
)
def test_readiness_is_what_the_features_say_that_a_device_tells(features, bits, said):
    motion = maps.parse_status([0] * 24 + [bits], features=features).motion
    assert (motion.referenced, motion.compensation) == said


def test_a_device_without_the_feature_is_not_asked_beyond_its_status_block():
    nobody = records.Identity("", "", "", "")
    old = maps.Controller(nobody, ("X",), ((0.0, 1.0),), 1.0, 1)
    assert old.status_block == r.STATUS
    newer = replace(old, features=r.TELLS_OVERRIDE | r.TELLS_REFERENCED)
    assert newer.status_block == r.Block(100, 25)


def test_the_page_shows_the_map():
    script = runpy.run_path(str(DOCS / "write_tables.py"))
    names = [name for name in script["TABLES"] if name.startswith("register")]
    assert not script["main"](names, check=True), "docs/write_tables.py"
    page = (DOCS / "modbus-register-map.md").read_text()
    assert all(f"`{register.name}`" in page for register in r.REGISTERS)
    assert all(verb.name in page for verb in r.Command)


LOOK_S = 2e-3  # how finely it is looked when the next attempt is due


def pauses_s(back_off: BackOff, count: int = 12) -> list[float]:
    """How long each attempt has to wait for, found by asking every millisecond."""
    now_s, found = 0.0, []
    for _ in range(count):
        back_off.put_off(now_s)
        due_s = now_s
        while not back_off.is_due(due_s):
            due_s += 1e-3
        found.append(due_s - now_s)
        now_s = due_s
    return found


@pytest.mark.fault_row(16)
def test_pauses_grow_up_to_a_bound_and_begin_anew_once_the_link_came_back():
    found = pauses_s(BackOff(lambda: 1.0))
    assert found[0] == pytest.approx(FIRST_S, abs=LOOK_S)
    growing = [pause for pause in found if pause < LONGEST_S - LOOK_S]
    assert len(growing) >= 3
    assert all(b > 1.5 * a for a, b in itertools.pairwise(growing))
    assert found[len(growing) :] == pytest.approx([LONGEST_S] * 9, abs=LOOK_S)
    back_off = BackOff(lambda: 1.0)
    pauses_s(back_off)
    back_off.reset()
    assert back_off.is_due(0.0)
    assert pauses_s(back_off, 1)[0] == pytest.approx(FIRST_S, abs=LOOK_S)


@pytest.mark.fault_row(16)
def test_two_hosts_do_not_come_back_at_the_same_moments():
    early, late = (pauses_s(BackOff(lambda share=share: share)) for share in (0.0, 1.0))
    for soon, far in zip(early, late, strict=True):
        assert soon == pytest.approx(0.5 * far, abs=LOOK_S)
    drawn = {round(sum(pauses_s(BackOff(), 4)), 2) for _ in range(20)}
    assert len(drawn) > 5
