"""The simple rivals of the diagnosis: what they fit, and the table beside it."""

from dataclasses import replace

import numpy as np
import pytest
from hilserver_injector import Recipe, make

from benchmarks import diagnose
from benchmarks.baselines import (
    EndErrors,
    NineTerms,
    applies,
    nine_terms,
    nine_terms_by_end,
    stepwise,
)
from benchmarks.diagnose_recordings import NINE_TERMS, Row, _figures
from benchmarks.diagnose_worker import measured
from hilserver.daemon.assembly import assemble
from hilserver.diagnosis.progress import Tracker
from hilserver.diagnosis.regression.gain import gains
from hilserver.diagnosis.regression.stages import prepare_all
from hilserver.diagnosis.schema.findings import Gain
from hilserver.measured.channels import GYRO, POSITION, YAW
from tests.benchmarks.test_diagnose import arguments

LATE_S = 0.15
RECIPE = Recipe(
    seed=3, causes={"rotation_gain": -0.3, "nav_latency": LATE_S, "yaw_latency": LATE_S}
)


def prepared_for(duration_s):
    recipe = replace(RECIPE, duration_s=duration_s)
    log = measured(make(recipe)[0])
    slim = replace(log, channels={n: log[n] for n in log.channels if "duty" not in n})
    return prepare_all(slim, assemble(None).robot, 1, Tracker())[0]["pose"]


@pytest.fixture(scope="module")
def prepared():
    return prepared_for(40.0)


def test_nine_terms_find_gain_and_delay(prepared):
    theta = NineTerms(prepared.problem).fitted()
    assert theta[0] == pytest.approx(1.0, abs=0.02)
    assert theta[5] == pytest.approx(0.7, abs=0.02)
    assert theta[8] == pytest.approx(LATE_S, abs=0.03)


def test_nine_terms_at_null_are_the_plant(prepared):
    """Each segment begins at the origin; from there the poses are the plant's."""
    problem = prepared.problem
    rival = NineTerms(problem)
    theta = np.array(NineTerms.NULL)
    theta[3] = -problem.stage.robot.icr_offset_m
    said = rival.predict(theta)
    plant = problem.predict({}, np.zeros_like(prepared.base.poses))
    off, turned = rival.missed(said)
    place, yaw = rival.missed(plant)
    assert np.abs(turned - yaw).max() < 2e-3
    assert np.abs(off - place).max() < 5e-3
    edge = problem.stack.edges[GYRO]
    assert said[edge] == pytest.approx(plant[edge], abs=0.02)


def test_both_rivals_gain_on_held_out_blocks(prepared):
    assert applies(prepared.problem)
    for rival in (nine_terms, stepwise):
        rng = np.random.default_rng(0)
        found = gains(
            prepared.problem, prepared.base.predicted, rival(prepared), 5.0, rng
        )
        assert found["yaw_rad"].ratio > 3.0
        assert found["position_m"].ratio > 1.5


def test_without_a_heading_nothing_is_compared(prepared):
    log = prepared.problem.stage.log
    channels = {n: log[n] for n in log.channels if n != YAW}
    blind = prepare_all(
        replace(log, channels=channels), assemble(None).robot, 1, Tracker()
    )[0]["pose"]
    assert all(name in blind.problem.stack.edges for name in POSITION)
    assert not applies(blind.problem)


def row(name, engine, ahead):
    gains = {
        rival: Gain(horizon_s=5.0, before=ratio, after=1.0, ratio=ratio, ci95=None)
        for rival, ratio in zip(NINE_TERMS, ahead, strict=True)
    }
    return Row(name=name, quantity="yaw", engine=engine, ahead=gains)


def test_figures_are_mean_and_worst_beside_the_better_nine_terms():
    rows = [row("a", 4.0, (4.0, 2.0)), row("b", 1.0, (1.0, 0.5))]
    assert [(r.name, r.value, r.reference_name) for r in _figures(rows)] == [
        ("yaw: geometric mean", pytest.approx(1.0), f"gain of {NINE_TERMS[1]}"),
        ("yaw: worst", 0.5, "bound"),
    ]


@pytest.mark.long  # 12 s for a rival; above, its sibling is fitted to the same problem
def test_end_errors_find_gain_and_delay_and_gain_on_held_out_blocks():
    """Nine values of few free runs would say nothing of the others."""
    made = prepared_for(240.0)
    theta = EndErrors(made.problem).fitted()
    assert theta[5] == pytest.approx(0.7, abs=0.02)
    assert theta[8] == pytest.approx(LATE_S, abs=0.05)
    rng = np.random.default_rng(0)
    found = gains(made.problem, made.base.predicted, nine_terms_by_end(made), 5.0, rng)
    assert found["yaw_rad"].ratio > 3.0
    assert found["position_m"].ratio > 1.5


@pytest.mark.parametrize("text", ["husky.yaml", "=run.csv", "husky.yaml="])
def test_a_recording_needs_its_mapping(tmp_path, text, capsys):
    with pytest.raises(SystemExit):
        arguments(tmp_path, words=["--recordings", text])
    assert "write both, as husky.yaml=run1.csv" in capsys.readouterr().err


def test_recordings_take_the_place_of_hidden_causes(tmp_path, monkeypatch):
    args = arguments(
        tmp_path, words=["--recordings", "husky.yaml=a.csv,b.csv", "w.yaml=c.csv"]
    )
    asked = []
    monkeypatch.setattr(
        "benchmarks.diagnose_recordings.measure", lambda m, *_: asked.extend(m) or []
    )
    assert diagnose.run(args) == []
    assert [(m, [f.name for f in files]) for m, files in asked] == [
        ("husky.yaml", ["a.csv", "b.csv"]),
        ("w.yaml", ["c.csv"]),
    ]
