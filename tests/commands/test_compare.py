"""`hilserver compare` on recordings that the product has written."""

import json

import pytest

from hilserver.commands import main
from hilserver.errors import EXIT_BAD_LOG, EXIT_DIFFERENT, EXIT_DONE, EXIT_FAILED

SCENARIO = """
steps:
  - {at_s: 0.0, write: {control.mode: 1, twist.linear_m_s: 0.3}}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("compare")
    scenario = folder / "drive.yaml"
    scenario.write_text(SCENARIO)
    for name, k_p in (("a.mcap", 13.513), ("b.mcap", 13.514), ("a.csv", 13.513)):
        config = folder / f"{name}.yaml"
        config.write_text(f"plant: {{controller: {{k_p: {k_p}}}}}\n")
        words = ["simulate", str(scenario), "-c", str(config), "--duration", "0.5"]
        assert main([*words, "-o", str(folder / name)]) == EXIT_DONE
    return folder


def compared(folder, *words):
    return main(["compare", *(str(folder / word) for word in words[:2]), *words[2:]])


def test_the_same_run_in_two_formats_is_equal(folder, capsys):
    assert compared(folder, "a.mcap", "a.csv") == EXIT_DONE
    assert capsys.readouterr().out.startswith("Equal: 500 rows of ")


def test_another_controller_is_a_difference_with_its_cause(folder, capsys):
    assert compared(folder, "a.mcap", "b.mcap") == EXIT_DIFFERENT
    said = capsys.readouterr().out
    assert "an output, while all inputs that both have were equal" in said
    assert "plant.controller.k_p: 13.513 in A, 13.514 in B" in said


def test_the_curves_of_both_are_written_where_asked(folder, tmp_path, capsys):
    words = ("a.mcap", "b.mcap", "-o", str(tmp_path / "new"))
    assert compared(folder, *words) == EXIT_DIFFERENT
    shown = json.loads((tmp_path / "new" / "comparison.json").read_bytes())
    assert shown["text"] == capsys.readouterr().out.strip()
    assert "wheel.fl.speed_rpm" in [curve["name"] for curve in shown["signals"]]


def test_a_folder_that_cannot_be_made_is_said_before_all_is_compared(
    folder, monkeypatch, capsys
):
    monkeypatch.setattr("hilserver.commands.compare.compare", None)
    a_file = folder / "drive.yaml"
    for out, sentence in ((a_file, "is a file; name a folder"), (a_file / "in", "")):
        assert compared(folder, "a.mcap", "b.mcap", "-o", str(out)) == EXIT_FAILED
        assert f"{out}: {sentence}" in capsys.readouterr().err


def test_within_the_tolerance_it_is_none(folder):
    words = ("a.mcap", "b.mcap", "--tolerance", "*=1.0")
    assert compared(folder, *words) == EXIT_DONE


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("a.mcap", "absent.mcap"), "absent.mcap: no such file or directory"),
        (("a.mcap", "a.mcap"), "a.mcap: is the same file; give another recording"),
        (("a.mcap", "b.mcap", "--tolerance", "pose=1"), "fits no signal of both"),
        (("a.mcap", "b.mcap", "--tolerance", "pose.x_m"), "is not SIGNAL=X"),
        (("a.mcap", "drive.yaml"), "drive.yaml: not a readable log"),
    ],
)
def test_what_cannot_be_compared_is_one_sentence(folder, words, sentence, capsys):
    try:
        code = compared(folder, *words)
    except SystemExit as ended:
        code = ended.code
    assert code == EXIT_BAD_LOG
    assert sentence in capsys.readouterr().err
