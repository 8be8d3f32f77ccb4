"""Marks on the command line: from files to a report, and what goes wrong with them."""

import json

import pytest

from hilserver.commands import main
from tests.diagnosis.marks.machines import Machine, Tape, squares, table

CONFIG = """
plant: {wheel_radius_m: 0.042, track_m: 0.2, max_rpm: 200, wheelbase_m: null, drive: skid}
kinematics: {rotation_gain: geometric_diff}
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    log, marks = squares(Machine.unequal(0.02), Tape(sd_m=0.01), 3, runs=6)
    (tmp_path / "squares.csv").write_text(table(log))
    (tmp_path / "marks.yaml").write_text(marks)
    (tmp_path / "config.yaml").write_text(CONFIG)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_log_and_its_marks_become_a_report(folder, capsys):
    words = "diagnose squares.csv -c config.yaml --marks marks.yaml -o out --jobs 1"
    assert main(words.split()) == 0
    said = capsys.readouterr()
    assert "shows the robot's dimensions by 12 marks" in said.err
    assert "The left wheels are" in said.out

    found = json.loads((folder / "out" / "findings.json").read_text())
    assert [f["causes"] for f in found["findings"]] == [["wheel_radius_difference"]]
    patch = (folder / "out" / "model_patch.yaml").read_text()
    assert "wheel_radius_difference" in patch
    report = (folder / "out" / "report.html").read_text()
    assert report.count("dot simulated") == report.count("dot extended") == 6
    assert "Where runs end" in report


@pytest.mark.parametrize(
    ("marks", "says"),
    [
        ("marks: [{t_s: 1.7e9, x_m: 0, y_m: 0, sd_m: 0.01}]", "write the time that"),
        ("marks: []", "marks.yaml"),
        ("other: 1", "marks.yaml"),
        (None, "no such file"),
    ],
)
def test_marks_that_do_not_fit_are_one_sentence(folder, capsys, marks, says):
    (folder / "marks.yaml").unlink()
    if marks is not None:
        (folder / "marks.yaml").write_text(marks)
    assert main(["diagnose", "squares.csv", "--marks", "marks.yaml", "-o", "out"]) == 2
    said = capsys.readouterr().err
    assert says in said
    assert "Traceback" not in said
    assert not (folder / "out").exists()
