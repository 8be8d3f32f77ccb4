"""`hilserver experiment`: an experiment of the thesis in, a report with its figures out."""

import re

import pytest

from hilserver.commands import main
from hilserver.experiment.drive import RECORDING


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_without_a_name_it_lists_the_experiments(capsys):
    assert main(["experiment"]) == 0
    assert re.findall(r"^(5\.\S+) ", capsys.readouterr().out, re.M) == [
        *("5.2.1", "5.2.2", "5.6.1", "5.6.2")
    ]


@pytest.mark.parametrize(
    ("words", "sentence", "code"),
    [
        (
            ["--measured", "a.csv"],
            "a.csv: name its experiment, too: one of 5.2.1, 5.2.2",
            2,
        ),
        (["5.6.1", "-o", "a.csv"], "a.csv: is a file; name a folder for the report", 1),
        (["5.6.1", "--measured", "no.csv"], "no.csv: no such file or directory", 2),
        (["5.6.1", "--measured", "a.csv"], "a.csv: ", 2),
        (["5.6.1", "-c", "a.yaml"], "a.yaml: no such file or directory", 78),
    ],
)
def test_a_mistake_is_one_sentence(here, capsys, words, sentence, code):
    (here / "a.csv").write_text("t_s,imu.gyro_z_rad_s\n0,0\n")
    assert main(["experiment", *words]) == code
    said = capsys.readouterr().err.splitlines()
    assert sentence in said[-1]
    assert [line for line in said[:-1] if "% " not in line] == [], "progress at most"


def test_an_unknown_name_is_a_mistake_in_the_command_line(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["experiment", "5.6"])
    assert ended.value.code == 2
    sentence = "no experiment is called '5.6'; did you mean '5.6."
    assert sentence in capsys.readouterr().err


def test_without_mujoco_it_drives_the_planar_plant_and_says_what_is_missing(
    here, monkeypatch, capsys
):
    monkeypatch.setattr("hilserver.body.engine.find_spec", lambda _: None)
    assert main(["experiment", "5.2.1"]) == 0
    said = capsys.readouterr()
    assert (
        "There is no mechatronic curve: it needs MuJoCo; install it with: pip"
        in said.err
    )
    assert "K_om by (5.19), all samples: 1.95" in said.out
    out = here / "experiment-5.2.1"
    assert (
        "the planar plant, which is the kinematic model"
        in (out / "report.html").read_text()
    )
    assert not (out / "mechatronic.csv").exists()

    # the recording is one like any other: that of a robot in another experiment, say
    assert (
        main(["experiment", "5.6.1", "--measured", str(out / RECORDING), "-o", "again"])
        == 0
    )
    assert f"what {RECORDING} measured" in (here / "again" / "report.html").read_text()
    assert not (here / "again" / RECORDING).exists()
