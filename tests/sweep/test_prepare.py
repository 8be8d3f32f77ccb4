"""A sweep's file: what it means, and one sentence for what it cannot mean."""

import json

import numpy as np
import pytest

from hilserver.config.root import Config
from hilserver.errors import ConfigError
from hilserver.plant.layout import Parameters
from tests.sweep.conftest import BASIC

JOINT = {
    "parameters": ["rotation_gain", "nav_latency", "clock_offset"],
    "value": [-0.3, 0.1, 0.02],
    "covariance": [[1e-4, 1e-5, 0.0], [1e-5, 1e-4, 0.0], [0.0, 0.0, 1e-6]],
}


def test_names_may_leave_out_their_sections(made):
    population = {
        "wheel_radius": {"sd": 0.01},
        "terms.coulomb_friction": {"uniform": [0, 4]},
        "battery.initial_charge": {"uniform": [0.2, 1]},
        "controller.k_i": {"sd": 5},
        "plant.track_m": {"mean": 0.3, "sd": 0.01},
        "wheel_load": {"uniform": [0, 1]},
    }
    assert made(**{"from": {"population": population}}).draws.names == (
        "terms.wheel_radius",
        "terms.coulomb_friction",
        "sensors.battery.initial_charge",
        "plant.controller.k_i",
        "plant.track_m",
        "terms.wheel_load.f",
    )


def test_a_machine_is_packed_as_its_robot(made):
    prepared = made()
    machine = prepared.machine(3)
    again = prepared.machine(3)
    assert machine.p.tobytes() == again.p.tobytes()
    p = Parameters.of(machine.p)
    assert p.seed == machine.seed
    assert p.charge_0 == machine.values["sensors.battery.initial_charge"]
    assert machine.p.tobytes() != prepared.machine(4).p.tobytes()


def test_what_no_robot_can_be_is_counted_not_clipped(made):
    prepared = made(
        **{"from": {"population": {"coulomb_friction": {"mean": 0, "sd": 1}}}}
    )
    machines = [prepared.machine(index) for index in range(40)]
    refused = [m for m in machines if m.p is None]
    assert {m.index for m in refused} == {
        m.index for m in machines if m.values["terms.coulomb_friction"] < 0.0
    }
    assert 10 < len(refused) < 30
    assert "outside" in refused[0].refused


def findings(folder, **changes):
    found = {
        "verdict": "findings",
        "logs": [],
        "seed": 0,
        "version": "0",
        "config_sha256": Config().sha256,
        "joint": JOINT,
    }
    (folder / "findings.json").write_text(json.dumps(found | changes))
    return {"from": {"findings": "findings.json"}}


def test_one_machine_as_its_diagnosis_left_it(made, tmp_path):
    prepared = made(**findings(tmp_path))
    assert prepared.draws.names == ("terms.rotation_gain", "terms.nav_latency")
    assert prepared.left_out == ("clock_offset",)
    values = [prepared.machine(i).values for i in range(300)]
    gains = np.array([v["terms.rotation_gain"] for v in values])
    assert gains.mean() == pytest.approx(-0.3, abs=0.005)
    assert gains.std() == pytest.approx(0.01, abs=0.002)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"config_sha256": "0" * 64}, "is from another robot"),
        ({"joint": None}, "has no joint"),
        (
            {"joint": JOINT | {"covariance": [[1.0, 2, 0], [2, 1.0, 0], [0, 0, 1]]}},
            "positive",
        ),
        (
            {
                "joint": {
                    "parameters": ["clock_offset"],
                    "value": [1],
                    "covariance": [[1]],
                }
            },
            "no par",
        ),
        ({"verdict": 3}, "is not a findings.json"),
    ],
)
def test_findings_that_do_not_fit(made, tmp_path, changes, says):
    with pytest.raises(ConfigError, match=says):
        made(**findings(tmp_path, **changes))


def test_findings_that_never_end(made, tmp_path):
    (tmp_path / "findings.json").symlink_to("/dev/zero")
    with pytest.raises(ConfigError, match="it is not a regular file"):
        made(**{"from": {"findings": "findings.json"}})


def test_without_findings(made):
    with pytest.raises(ConfigError, match="no such file"):
        made(**{"from": {"findings": "none.json"}})


POPULATION = BASIC["from"]["population"]


@pytest.mark.parametrize(
    ("sections", "says"),
    [
        ({"machines": 10**9}, "machines"),
        ({"machnes": 5}, "did you mean 'machines'"),
        ({"from": {"population": {"a": {"uniform": [4, 0]}}}}, "swap the two numbers"),
        (
            {"from": {"population": {"rotation_gian": {"sd": 1}}}},
            "no such parameter; did you mean",
        ),
        ({"from": {"population": {"track_m": {"sd": -1}}}}, "greater than 0"),
        (
            {"from": {"population": {"mechatronic.mass_kg": {"sd": 1}}}},
            "no such|is fixed",
        ),
        ({"from": {"population": {"setpoint_rate_limit": {"sd": 1}}}}, "write a mean"),
        (
            {"from": {"population": POPULATION | {"terms.rotation_gain": {"sd": 1}}}},
            "drawn twice",
        ),
        ({"from": {}}, "name findings, a population or both"),
        ({"drive": {}}, "duration_s is needed"),
        ({"drive": {"scenario": "none.yaml"}}, "no such file"),
        ({"require": []}, "require"),
        (
            {"require": [{"name": "a", "signal": "pose.z", "below": 1}]},
            "no scalar signal 'pose.z'",
        ),
        (
            {
                "require": [
                    {"name": "a", "signal": "pose.x_m", "below": 1, "after_s": 9}
                ]
            },
            "this one ends after 1 s",
        ),
        ({"controller": {"python": "my.py:Controller"}}, "python needs every_ms"),
        ({"controller": {"block": "limit.py:limit"}}, "block needs drives"),
        (
            {"controller": {"block": "my.py:Controller", "drives": {"a": "b"}}},
            "not declared|free",
        ),
        (
            {"controller": {"python": "a:b", "block": "c:d", "every_ms": 5}},
            "write exactly one of block",
        ),
        (
            {
                "faults": [
                    {"share": 2, "fault": {"fault": "stuck", "signal": "pose.x_m"}}
                ]
            },
            "share",
        ),
    ],
)
def test_what_a_file_cannot_mean_is_one_sentence(made, sections, says):
    with pytest.raises(ConfigError, match=says) as error:
        made(**sections)
    assert ".yaml:" in str(error.value)


def test_a_scenario_that_sets_parameters_is_refused(made, tmp_path):
    (tmp_path / "set.yaml").write_text(
        "steps: [{at_s: 0.5, set: {plant.controller.k_i: 100}}]"
    )
    with pytest.raises(ConfigError, match=r"set.yaml:1: steps\[0\].set: a sweep draws"):
        made(drive={"scenario": "set.yaml"})


def test_how_many_machines_there_are_does_not_change_the_key(made):
    assert made(machines=6).job.key == made(machines=9).job.key
    assert made(machines=6).job.key != made(seed=8).job.key
