"""A log with nothing hidden has the sensors' noise and nothing else."""

import numpy as np
import pytest
from hilserver_injector import Noise, Recipe, make
from hilserver_injector.sensors import OM, YAW, X, Y
from hilserver_injector.ultra_wideband import NoRecordingError, residuals

from tests.helpers.recordings import recording


@pytest.fixture(scope="module")
def log():
    table, truth = make(Recipe(seed=11))
    return table, truth.dense[np.round(table.t_s * 1e3).astype(int)]


def sampled(table, name):
    values = table.columns[name]
    there = np.isfinite(values)
    return there, values[there]


def correlation(series, lag):
    return np.corrcoef(series[:-lag], series[lag:])[0, 1]


def test_position(log):
    table, truth = log
    for name, column in (("nav.x_m", X), ("nav.y_m", Y)):
        there, values = sampled(table, name)
        error = values - truth[there, column]
        assert error.std() == pytest.approx(np.hypot(0.05, 0.01), rel=0.15)
        assert correlation(error, 12) == pytest.approx(np.exp(-1.0) * 25 / 26, abs=0.12)


def test_yaw(log):
    table, truth = log
    there, values = sampled(table, "nav.yaw_rad")
    error = np.angle(np.exp(1j * (values - truth[there, YAW])))
    assert error.std() == pytest.approx(0.015, rel=0.25)
    assert correlation(error, 40) == pytest.approx(np.exp(-1.0), abs=0.2)


def test_gyro_is_white(log):
    table, truth = log
    there, values = sampled(table, "imu.gyro_z_rad_s")
    error = values - truth[there, OM]
    assert error.std() == pytest.approx(0.006, rel=0.03)
    assert abs(correlation(error, 1)) < 0.03


def test_rates(log):
    table, _ = log
    assert len(table.t_s) == 50 * 360
    assert np.all(np.diff(table.t_s) > 0.010)
    there, _ = sampled(table, "nav.x_m")
    assert there.sum() == pytest.approx(20 * 360, rel=0.01)
    there, _ = sampled(table, "wheel.fl.setpoint_rpm")
    assert there.all()


def test_the_drive_visits_what_the_causes_need(log):
    table, truth = log
    setpoint = table.columns["wheel.fl.setpoint_rpm"]
    assert np.mean(np.abs(setpoint) > 61.0) > 0.05
    assert setpoint.min() < -30.0
    assert np.abs(truth[:, [X, Y]]).max() < 6.5
    assert np.ptp(truth[:, X]) > 5.0
    assert np.ptp(truth[:, Y]) > 5.0
    assert truth[:, OM].min() < -0.5
    assert truth[:, OM].max() > 0.5


def test_same_seed_same_log():
    first, _ = make(Recipe(seed=4, duration_s=5.0))
    again, _ = make(Recipe(seed=4, duration_s=5.0))
    other, _ = make(Recipe(seed=5, duration_s=5.0))
    for name, values in first.columns.items():
        np.testing.assert_array_equal(values, again.columns[name])
    assert not np.array_equal(
        first.columns["nav.x_m"], other.columns["nav.x_m"], equal_nan=True
    )


def test_measured_noise_needs_the_recording(monkeypatch):
    monkeypatch.delenv("HIL_DATA_DIR", raising=False)
    with pytest.raises(NoRecordingError, match="HIL_DATA_DIR"):
        make(Recipe(duration_s=2.0, noise=Noise(measured_position=True)))


def test_measured_noise_is_never_white():
    _, errors = residuals(str(recording("uwb_trolley").parent))
    for series in errors:
        assert 0.02 < series.std() < 0.08
        assert correlation(series, 50) > 0.5  # after 0.5 s
