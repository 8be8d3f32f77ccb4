"""Scenarios: played to the tick, again after a reset, and refused with file, line and key."""

import json

import jsonschema
import numpy as np
import pytest
import yaml

from hilserver.commands import main
from hilserver.config.section import schema_text
from hilserver.faults.scenario import Scenario, as_yaml, load_scenario
from hilserver.testing.opening import open_hil

TEXT = """\
scenario: a port that lies from t to t
seed: 7
steps:
  - {at_s: 0.010, write: {wheel.fl.setpoint_rpm: 30, wheels.setpoints_rpm: [10, 20, 30, 40]}}
  - {at_s: 0.030, write: {drive.enable: false, lights.red: 9}}
faults:
  - {fault: bias, signal: pose.x_m, offset: 2.5, from_s: 0.020, until_s: 0.025}
  - {fault: noise, signal: pose.y_m, sd: 0.1, from_s: 0.0}
  - {fault: force, signal: battery.voltage_v, value: 7, from_s: 0.040, for_s: 0.005}
"""


@pytest.fixture
def scenario(tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text(TEXT)
    return path


async def test_everything_happens_at_its_tick_and_again_after_a_reset(scenario):
    async def play(hil, n):
        async with hil.capture() as trace:
            await hil.step(n)
        return trace

    async with open_hil(None, "virtual", scenario=scenario) as hil:
        trace = await play(hil, 60)
        assert hil.daemon.gate.owner == "scenario"
        at = dict(
            zip(trace.tick.tolist(), trace["wheel.fl.setpoint_rpm"].values, strict=True)
        )
        assert (at[9], at[10]) == (0, 10)
        at = dict(zip(trace.tick.tolist(), trace["pose.x_m"].values, strict=True))
        assert [tick for tick, x in at.items() if x > 1] == [20, 21, 22, 23, 24]
        at = dict(
            zip(trace.tick.tolist(), trace["battery.voltage_v"].values, strict=True)
        )
        assert [tick for tick, volts in at.items() if volts == 7] == [
            40,
            41,
            42,
            43,
            44,
        ]
        assert hil.read("drive.enable") == 0
        first = {
            name: trace[name].values for name in trace if not name.startswith("sim.")
        }
        hil.daemon.control.reset()
        await hil.step(1)
        again = await play(hil, 60)
        assert again.tick[0] == 1
        assert all(np.array_equal(again[name].values, first[name]) for name in first)


SETS = """\
steps:
  - {at_s: 0.0, write: {control.mode: 1, twist.angular_rad_s: 0.5}}
  - {at_s: 0.050, set: {terms.rotation_gain: -0.3, plant.controller.k_p: 15}}
  - {at_s: 0.800, set: {terms.rotation_gain: 0}}
"""


async def test_parameters_change_at_their_tick_whatever_else_changes(tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text(SETS)
    async with open_hil(None, "virtual", scenario=path) as hil:
        parameters, edition = (
            hil.daemon.core.parameters,
            hil.daemon.table.slot("internal.edition"),
        )

        async def first_tick(change):
            while True:
                await hil.step(1)
                frame = hil.daemon.image.latest()
                if frame.values[edition] >= change:
                    return frame.tick

        assert await first_tick(1) == 50
        assert parameters.differing == {
            "terms.rotation_gain": -0.3,
            "plant.controller.k_p": 15.0,
        }
        assert await hil.set_parameter("plant.max_rpm", 70.0) == 51
        assert await first_tick(3) == 800
        assert parameters.differing == {
            "plant.max_rpm": 70.0,
            "plant.controller.k_p": 15.0,
        }
        hil.daemon.control.reset()
        await hil.step(60)
        assert parameters.differing["terms.rotation_gain"] == -0.3, (
            "a Reset plays it again"
        )


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        (
            ("rotation_gain: -0.3", "rotation: -0.3"),
            ":3: steps[1].set.terms.rotation: ",
        ),
        (
            ("-0.3", "-30"),
            ":3: steps[1].set.terms.rotation_gain: terms.rotation_gain: -30 is",
        ),
        (
            ("k_p: 15", "k_p: 1.0e+6"),
            ":3: steps[1].set: plant.slice: slice 'plant' has 1 ms, but",
        ),
        (
            ("set: {terms.rotation_gain: 0}", ""),
            ":4: steps[2]: a step needs 'write' or 'set'",
        ),
    ],
)
def test_parameters_that_cannot_be_are_refused_before_the_start(
    tmp_path, capsys, wrong, sentence
):
    path = tmp_path / "scenario.yaml"
    path.write_text(SETS.replace(*wrong))
    config = tmp_path / "config.yaml"
    config.write_text(
        "opcua: {enabled: false}\nmetrics: {enabled: false}\nimage: {name: auto}\n"
    )
    assert (
        main(["run", "-c", str(config), "--scenario", str(path), "--duration", "1"])
        == 78
    )
    assert sentence in capsys.readouterr().err


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        (("seed: 7", "seed: many"), ":2: seed: 'many' is not valid"),
        (("offset: 2.5, ", ""), ":7: faults[0]: bias needs 'offset'"),
        (("pose.x_m", "pose.w_m"), ":7: faults[0]: there is no signal 'pose.w_m'"),
        (
            ("lights.red: 9", "lights.red: 900"),
            ":5: steps[1].write.lights.red: 900.0 does not",
        ),
        (
            ("lights.red: 9", "pose.x_m: 9"),
            ":5: steps[1].write.pose.x_m: 'pose.x_m' is an output",
        ),
        (
            ("lights.red: 9", "light.red: 9"),
            ":5: steps[1].write.light.red: there is no signal",
        ),
        (("seed: 7", "sead: 7"), ":2: unknown key 'sead'; did you mean 'seed'?"),
        (
            ("red: 9}", "red: 9}, x: 1"),
            ":5: unknown key 'steps[1].x'; known are at_s, set, write",
        ),
        (("fault: bias", "fault: bais"), ":7: faults[0].fault: 'bais' is not valid"),
        (("steps:", "steps: ["), "not YAML"),
    ],
)
def test_a_bad_scenario_is_one_sentence_and_exit_code_78(
    scenario, capsys, wrong, sentence
):
    scenario.write_text(TEXT.replace(*wrong))
    config = scenario.with_name("config.yaml")
    config.write_text(
        "opcua: {enabled: false}\nmetrics: {enabled: false}\nimage: {name: auto}\n"
    )
    assert (
        main(["run", "-c", str(config), "--scenario", str(scenario), "--duration", "1"])
        == 78
    )
    said = capsys.readouterr().err
    assert sentence in said
    assert said.startswith(f"hilserver: {scenario}")
    assert said.count("\n") == 1


def test_run_plays_a_scenario(scenario, capsys):
    config = scenario.with_name("config.yaml")
    config.write_text(
        "opcua: {enabled: false}\nmetrics: {enabled: false}\nimage: {name: auto}\n"
    )
    assert (
        main(
            ["run", "-c", str(config), "--scenario", str(scenario), "--duration", "0.3"]
        )
        == 0
    )


def test_the_schema_accepts_what_the_model_accepts(scenario, tmp_path):
    assert main(["run", "--scenario-schema", str(tmp_path / "schema.json")]) == 0
    text = (tmp_path / "schema.json").read_text()
    assert text == schema_text(Scenario)
    schema = json.loads(text)
    jsonschema.validate(yaml.safe_load(TEXT), schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(yaml.safe_load(TEXT.replace("offset: 2.5, ", "")), schema)


def test_what_is_written_as_yaml_reads_the_same(scenario):
    read = load_scenario(scenario)
    data = read.model_dump(exclude_none=True, mode="json")
    assert Scenario.model_validate(yaml.safe_load(as_yaml(data))) == read


def test_more_faults_than_fit_are_one_sentence(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    faults = [
        f"- {{fault: noise, signal: pose.x_m, sd: 1, name: n{i}}}" for i in range(33)
    ]
    (tmp_path / "many.yaml").write_text("\n".join(["faults:", *faults]))
    assert main(["simulate", "many.yaml", "-o", "out.csv"]) == 78
    said = capsys.readouterr().err
    assert said.startswith(
        "hilserver: many.yaml:1: faults: more than 32 signals cannot be"
    )
    assert said.endswith("; leave some out\n")
