import csv
import json

import numpy as np
import pytest

from hilserver.commands import main
from tests.identify.drives import correlated, measured, spins
from tests.identify.test_drive_limits import incremental, standing, sweep
from tests.identify.test_step_response import bench


def written(path, log):
    names = list(log.channels)
    with path.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["t_s", *names])
        rows.writerows(
            zip(log[names[0]].t_s, *(log[n].values for n in names), strict=True)
        )
    return str(path)


@pytest.fixture(scope="module")
def spin(tmp_path_factory):
    drive = spins(1.12, imu_late_s=0.075, duration_s=40.0, rng=np.random.default_rng(4))
    return written(tmp_path_factory.mktemp("logs") / "spin.csv", measured(*drive))


def test_rotation_in_words(spin, capsys):
    assert main(["identify", "rotation", spin]) == 0
    text = capsys.readouterr().out
    assert "K_om, steady speeds        1.1" in text
    assert "! the yaw rate comes 75 ms after" in text
    assert text.count("yes:") == 3


def test_rotation_as_json(spin, capsys):
    assert (
        main(["identify", "rotation", spin, "--json", "--zone", "2", "--settle", "0.5"])
        == 0
    )
    values = json.loads(capsys.readouterr().out)
    assert values["schema"] == "hilserver.identify/1"
    assert values["identified"] == "rotation"
    assert values["zone_rpm"] == 2.0
    assert values["lag_s"]["value"] == pytest.approx(0.075, abs=0.003)
    assert values["lag_s"]["unit"] == "s"
    assert [check["passed"] for check in values["checks"]] == [True, True, True]


@pytest.mark.parametrize(
    ("what", "make", "words"),
    [
        ("step", lambda: bench(1), "Strejc, from the tangent"),
        ("update-rate", lambda: incremental(5, 1), "update period  4.9"),
        ("dead-zone", lambda: sweep(-15.0, 25.0), "fl: at rest from -15.5 %"),
        ("noise", lambda: standing(turning=True), "nav.x_m"),
    ],
)
def test_every_kind_speaks_words_and_json(tmp_path, capsys, what, make, words):
    path = written(tmp_path / "log.csv", make())
    assert main(["identify", what, path]) == 0
    assert words in capsys.readouterr().out
    assert main(["identify", what, path, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["identified"] == what


def test_noise_of_errors_is_taken_everywhere(tmp_path, capsys):
    t_s = np.arange(0.0, 60.0, 0.05)
    errors = correlated(np.random.default_rng(5), t_s, 0.05, 0.6)
    path = written(tmp_path / "errors.csv", measured(t_s, {"nav.x_m": errors}))
    assert main(["identify", "noise", path]) == 2
    assert "never stands still" in capsys.readouterr().err
    assert main(["identify", "noise", path, "--everywhere", "--json"]) == 0
    (channel,) = json.loads(capsys.readouterr().out)["channels"]
    assert channel["noise"]["ou_sd"] == pytest.approx(0.05, rel=0.25)
    assert channel["noise"]["tail_dof"] is None


def test_step_input_can_be_chosen(tmp_path, capsys):
    path = written(tmp_path / "bench.csv", bench(1))
    assert main(["identify", "step", path, "--input", "setpoint"]) == 2
    assert "no wheel has a step" in capsys.readouterr().err


def test_wrong_option_is_refused(spin):
    with pytest.raises(SystemExit):
        main(["identify", "rotation", spin, "--zone", "-1"])
