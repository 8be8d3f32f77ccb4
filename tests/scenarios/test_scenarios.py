"""The named drives: complete, sealed, and judged by their expectation."""

import json

import numpy as np
import pytest
from hilserver_injector import make

from hilserver.commands import main
from hilserver.diagnosis.catalogue.vocabulary import CAUSES
from hilserver.diagnosis.schema.findings import Finding, Findings
from hilserver.scenarios import SCENARIOS
from hilserver.scenarios.expectation import Expectation
from reference.scenarios.judging import judge

NAMES = """friction_load k_omega_low surface_null surface_real unsteady_bias pulls_aside
slides_in_circle launch_slip fast_input radio small_deviation fused_yaw on_a_frame rates
interpolated signs_units slow_slice""".split()  # noqa: SIM905 (one list)


def findings(*said, verdict="findings"):
    made = [
        Finding(verdict=kind, causes=causes, block="drive") for kind, causes in said
    ]
    return Findings(
        verdict=verdict,
        logs=(),
        seed=0,
        version="",
        config_sha256="",
        findings=tuple(made),
    )


def test_all_of_the_thesis_are_there():
    assert list(SCENARIOS) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_expectations_use_the_vocabulary(name):
    for seed in range(4):
        drive = SCENARIOS[name].draw(seed)
        expected = drive.expectation
        said = frozenset().union(expected.together, *expected.must_say)
        assert said <= set(CAUSES), "what must be said is in the vocabulary"
        assert said or expected.verdict
        assert not said & expected.must_not_say


def test_the_seed_draws():
    first, again, other = (SCENARIOS["friction_load"].draw(seed) for seed in (1, 1, 2))
    assert first == again
    assert first.logs != other.logs


def test_make_seals_the_truth(tmp_path, capsys):
    assert (
        main(["scenarios", "make", "slow_slice", "-o", str(tmp_path), "--seed", "3"])
        == 0
    )
    log = (tmp_path / "logs" / "drive.csv").read_text(encoding="utf-8").splitlines()
    assert log[0].startswith("t_s,wheel.fl.setpoint_rpm")
    assert "duty" not in log[0], "the real robot publishes no duty"
    assert "control_period" not in (tmp_path / "config.yaml").read_text(
        encoding="utf-8"
    )
    truth = json.loads((tmp_path / "sealed" / "truth.json").read_text(encoding="utf-8"))
    assert truth["must_say"] == [["control_period"]]
    assert truth["recipes"]["drive.csv"]["causes"] == {"control_period": 0.01}
    assert "hilserver diagnose" in capsys.readouterr().out


def test_compare_scenarios_have_two_groups(tmp_path):
    assert main(["scenarios", "make", "surface_real", "-o", str(tmp_path)]) == 0
    assert len(list((tmp_path / "logs").iterdir())) == 3
    assert len(list((tmp_path / "against").iterdir())) == 3


def test_wheels_in_the_air_do_not_move_the_robot():
    drive = SCENARIOS["on_a_frame"].draw(0)
    table, _ = make(drive.logs["air.csv"])
    gyro = table.columns["imu.gyro_z_rad_s"]
    assert np.nanstd(gyro) == pytest.approx(0.006, rel=0.05)
    assert np.nanmax(np.abs(table.columns["wheel.fl.speed_rpm"])) > 20.0


def test_unknown_name(capsys):
    assert main(["scenarios", "make", "pulls_asid", "-o", "unused"]) == 1
    assert "did you mean 'pulls_aside'" in capsys.readouterr().err


EXPECTED = Expectation(
    must_say=(frozenset({"imu_latency"}),), must_not_say=frozenset({"rotation_gain"})
)


def test_right():
    assert judge(EXPECTED, findings(("named", ("imu_latency",)))).right
    assert judge(
        EXPECTED, findings(("named_group", ("imu_latency", "yaw_latency")))
    ).right


@pytest.mark.parametrize(
    "said",
    [
        (),
        (("structure_not_in_library", ()),),
        (("insufficient_excitation", ("imu_latency",)),),
    ],
)
def test_missed_but_not_wrong(said):
    result = judge(EXPECTED, findings(*said))
    assert not result.right
    assert not result.wrong


def test_wrong_name_beside_the_right_one():
    result = judge(
        EXPECTED, findings(("named", ("imu_latency",)), ("named", ("gyro_scale",)))
    )
    assert not result.right
    assert result.wrong == ("gyro_scale",)


def test_forbidden_name_in_a_group_with_the_truth():
    result = judge(
        EXPECTED, findings(("named_group", ("imu_latency", "rotation_gain")))
    )
    assert not result.right
    assert not result.wrong
    assert result.missing == ("said rotation_gain",)


def test_group_must_be_whole():
    expected = Expectation(together=frozenset({"rotation_gain", "gyro_scale"}))
    assert judge(
        expected, findings(("named_group", ("gyro_scale", "rotation_gain")))
    ).right
    assert not judge(expected, findings(("named", ("rotation_gain",)))).right


def test_verdict_on_the_whole():
    expected = Expectation(verdict="no_difference")
    assert judge(expected, findings(verdict="no_difference")).right
    assert not judge(expected, findings(verdict="differs")).right
