"""What a person sees: a bar at a terminal, a line a stage in a log."""

from truepath.cli.terminal import print_table, show_progress


def test_a_log_gets_a_line_a_stage(capsys):
    with show_progress("measure") as report:
        for share in (0.0, 0.2, 0.5):
            report(share, "measuring", f"{share} lost")
        report(1.0, "closing")
        report(1.0, "")
    said = capsys.readouterr()
    assert said.err.splitlines() == ["measure: measuring", "measure: closing"]
    assert said.out == ""


def test_a_terminal_gets_a_bar_with_share_stage_and_note(monkeypatch, capsys):
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("COLUMNS", "120")
    with show_progress("measure") as report:
        report(0.25, "measuring", "8000 samples, 0 lost")
    said = capsys.readouterr()
    assert "measuring" in said.err
    assert "25%" in said.err
    assert "8000 samples, 0 lost" in said.err
    assert said.out == ""


def test_a_table_keeps_its_columns(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "100")
    print_table("Errors", ("error", "value"), [("EXX", "1.5"), ("C0Y", "-20.0")])
    lines = capsys.readouterr().out.splitlines()
    assert any("EXX" in line and line.rstrip().endswith("1.5 │") for line in lines)
