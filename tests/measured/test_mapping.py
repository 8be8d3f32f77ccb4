"""Mapping files: units."""

import pytest

from hilserver.measured.mapping import LogMapping
from hilserver.measured.names import conversion, known_signals, units_of


@pytest.mark.parametrize("signal", known_signals())
def test_units_there_and_back_give_the_same(signal):
    unit = known_signals()[signal].unit
    for other in units_of(unit):
        assert conversion(unit, other) * conversion(other, unit) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("unit", "wanted", "factor"),
    [
        ("rad/s", "rpm", 9.5493),
        ("deg", "rad", 0.017453),
        ("km/h", "m/s", 0.27778),
        ("1", "%", 100),
    ],
)
def test_units_have_the_factors_of_the_books(unit, wanted, factor):
    assert conversion(unit, wanted) == pytest.approx(factor, rel=1e-4)
    assert conversion(unit, "V") is None


def test_sign_and_scale_make_one_factor():
    channel = {"column": "a", "unit": "rad/s", "sign": -1, "scale": 2}
    mapping = LogMapping.model_validate({"channels": {"wheel.fr.speed_rpm": channel}})
    assert mapping.factor("wheel.fr.speed_rpm") == pytest.approx(-2 * 9.5493, rel=1e-4)
