"""Requirements meet the signals of a robot, and a user's own functions."""

import numpy as np
import pytest

from hilserver.errors import ConfigError
from hilserver.requirements import (
    CheckError,
    Drive,
    Judge,
    Requirement,
    load_requirements,
)
from hilserver.signals import Ranges, robot_table

TABLE = robot_table(Ranges(90.0, 0.8, 5.0))
CHECKS = """
import numpy as np

def jerk(drive):
    return np.abs(np.gradient(drive["imu.accel_x_m_s2"], drive.period_s))

def longest(drive):
    return drive.time_s[-1]

def wrong(drive):
    return drive["imu.accel_x_m_s2"][:3]

def broken(drive):
    return drive["nothing"]
"""
FILE = """
machines: 3
require:
  - {name: comfortable, python: checks.py:jerk, signals: [imu.accel_x_m_s2], below: 3.0}
  - {name: arrives, signal: pose.x_m, above: 4.9, within_s: 40}
"""


@pytest.fixture
def file(tmp_path):
    (tmp_path / "checks.py").write_text(CHECKS)
    path = tmp_path / "sweep.yaml"
    path.write_text(FILE)
    return path


def test_a_sweep_is_a_file_of_requirements(file):
    judge = Judge(load_requirements(file), TABLE, file)
    assert judge.signals == ("imu.accel_x_m_s2", "pose.x_m")
    drive = Drive(
        0.5, {"imu.accel_x_m_s2": np.array([0.0, 1.0, 2.0]), "pose.x_m": np.arange(3.0)}
    )
    assert judge.margins(drive) == {"comfortable": 1.0, "arrives": pytest.approx(-2.9)}


def judged(file, **keys):
    judge = Judge([Requirement(name="r", below=3.0, **keys)], TABLE, file)
    return judge.margins(Drive(0.5, {name: np.zeros(5) for name in judge.signals}))


def test_a_function_that_returns_a_number_judges_the_whole_drive(file):
    assert judged(file, python="checks.py:longest") == {"r": 1.0}
    everything = Judge(
        [Requirement(name="r", python="checks.py:longest", below=1)], TABLE, file
    )
    assert set(everything.signals) == {s.name for s in TABLE if not s.is_array}


@pytest.mark.parametrize(
    ("function", "says"),
    [("wrong", r"shape \(3,\)"), ("broken", r"KeyError.*checks.py:14")],
)
def test_a_function_that_fails_is_one_sentence(file, function, says):
    with pytest.raises(CheckError, match=says):
        judged(file, python=f"checks.py:{function}")


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"signal": "pose.x"}, "did you mean 'pose.x_m'"),
        ({"signal": "wheels.speeds_rpm"}, "no scalar signal"),
        ({"python": "checks.py:nothing"}, "there is no 'nothing'"),
        ({"python": "other.py:jerk"}, "there is no file"),
        ({"python": "jerk"}, "write file.py:name"),
        ({"python": "no.such.module:jerk"}, "the import failed"),
    ],
)
def test_what_does_not_exist_is_refused_with_its_place(file, keys, says):
    with pytest.raises(ConfigError, match=says) as error:
        judged(file, **keys)
    assert str(error.value).startswith(f"{file}:4: require[0].")


def test_two_of_one_name(file):
    twice = [Requirement(name="r", signal="pose.x_m", below=1)] * 2
    with pytest.raises(ConfigError, match="two requirements have the name 'r'"):
        Judge(twice, TABLE, file)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{}", "'require' is missing"),
        ("require: []", "it should be 1 or more entries"),
        (
            "require: [{name: a, signal: s, below: 1, witin_s: 3}]",
            "did you mean 'within_s'",
        ),
    ],
)
def test_typos(tmp_path, text, says):
    path = tmp_path / "r.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=says):
        load_requirements(path)
