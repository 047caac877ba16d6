"""Options of `truepath simulate` that cannot be."""

import pytest

from truepath_simulators.bench.command import main


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--machine", "nowhere.json"], "nowhere.json"),
        (["--fault", "tracker:explode"], "explode"),
        (["--speed", "0"], "speed"),
        (["--speed", "nan"], "speed"),
        (["--seed", "-1"], "seed"),
        (["--tracker-port", "99999"], "tracker-port"),
        (["--modbus-port", "-5"], "modbus-port"),
        (["--error-scale", "inf"], "error-scale"),
        (["--protocol", "t2sa"], "over TCP alone"),
        (["--replay", "run.sqlite", "--fault", "tracker:silence"], "only repeats"),
    ],
)
def test_bad_input_is_exit_status_2_and_a_clear_line(options, said, capsys):
    try:
        status = main(options)
    except SystemExit as end:
        status = end.code
    assert status == 2
    assert said in capsys.readouterr().err


def test_a_file_of_somebody_else_is_not_touched(tmp_path, capsys):
    file = tmp_path / "tracker"
    file.write_text("kept")
    assert main(["--links", str(tmp_path)]) == 2
    assert "exists" in capsys.readouterr().err
    assert file.read_text() == "kept"
