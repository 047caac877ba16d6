"""`truepath doctor` shows by which ways a sensor may be read, and which is likely."""

import struct
import threading
from contextlib import contextmanager

import pytest

from truepath.cli.command import run
from truepath_simulators.cnc import modbus

pytestmark = pytest.mark.fault_row(43)


@contextmanager
def serving(words):
    """Serve holding registers of one unit, from address 10 on; yield where."""

    def answer(unit, pdu):
        function, address, count = struct.unpack(">BHH", pdu)
        held = words[address - 10 : address - 10 + count]
        if address < 10 or len(held) < count:
            return modbus.exception(pdu, modbus.ILLEGAL_ADDRESS)
        return struct.pack(f">BB{count}H", function, 2 * count, *held)

    def serve():
        while not ending.wait(0.002):
            port.serve(answer)

    port, ending = modbus.ModbusTcpPort("127.0.0.1", 0, (1,)), threading.Event()
    thread = threading.Thread(target=serve)
    thread.start()
    yield port.address
    ending.set()
    thread.join()
    port.close()


def words_of(value):
    return list(struct.unpack(">2H", struct.pack(">f", value)))


@pytest.fixture
def ask(tmp_path, capsys):
    def ask(words, **row):
        row = {"name": "X_degC", "address": 10, "function": "holding"} | row
        with serving(words) as address:
            options = "".join(f"{k} = {v!r}\n" for k, v in address.items())
            keys = "".join(f"{k} = {v!r}\n" for k, v in row.items())
            (tmp_path / "t.toml").write_text(
                f"data_dir = {str(tmp_path / 'data')!r}\n"
                f"machine_file = {str(tmp_path / 'none.json')!r}\n"
                'thermometer_driver = "modbus-registers"\n'
                'tracker_options = {host = "127.0.0.1", port = 1}\n'
                'motion_options = {host = "127.0.0.1", port = 1}\n'
                f"[thermometer_options]\n{options}"
                f"[[thermometer_options.registers]]\n{keys}"
            )
            run(["doctor", "--config", str(tmp_path / "t.toml")])
        return capsys.readouterr().out

    return ask


def line_of(said, subject):
    return next(x for x in said.splitlines() if x.split()[1:2] == [subject])


@pytest.mark.parametrize("value", [20.5, 20.53, -3.25, 20.02])
def test_words_in_the_wrong_order_are_refused_by_name(ask, value):
    said = ask(words_of(value)[::-1], type="float32")
    refused = line_of(said, "thermometer")
    assert refused.startswith("WRONG")
    assert "X_degC: its words are in the other order" in refused
    shown = line_of(said, "X_degC")
    assert 'word_order = "little" (likely)' in shown
    assert f"{value:g}" in shown


def test_an_address_beside_is_shown_where_that_of_the_settings_holds_nothing(ask):
    shown = line_of(ask([0, 205, 0], scale=0.1), "X_degC")
    assert shown.startswith("warning")
    assert "0.0 with address = 10 (as set)" in shown
    assert "20.5 with address = 11 (likely)" in shown


@pytest.mark.parametrize(
    ("words", "row", "state", "shown"),
    [
        (words_of(20.53), {"type": "float32"}, "ok", '"big" (as set) (likely)'),
        ([0x7FFF, 205], {"scale": 0.1}, "ok", ""),  # dead, beside another
        ([2053, 0], {"type": "int32", "scale": 0.01}, "", 'word_order = "little"'),
    ],
)
def test_words_as_set_are_ok_and_whole_numbers_compared(ask, words, row, state, shown):
    said = ask(words, **row)
    assert line_of(said, "thermometer").startswith(state)
    assert not shown or shown in line_of(said, "X_degC")
