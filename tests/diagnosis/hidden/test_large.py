"""Effects much larger than the reference sizes, where no cause is linear any more."""

from dataclasses import replace

import pytest

from hilserver.plant.terms import TERMS
from tests.diagnosis.assertions import the_cause_is_named, the_value_is_right
from tests.diagnosis.hidden.logs import judged, recipe

LARGE = [
    ("rotation_gain", 31, 120.0, {"rotation_gain": 0.3}),
    ("rotation_gain", 32, 120.0, {"rotation_gain": -0.3}),
    ("imu_latency", 31, 180.0, {"imu_latency": 0.15}),
    ("nav_latency", 31, 180.0, {"nav_latency": 0.3}),
    ("actuation_delay", 31, 60.0, {"actuation_delay": 0.12}),
    ("saturation_limit", 31, 60.0, {"saturation_limit": 35.0}),
    ("coulomb_friction", 31, 30.0, {"coulomb_friction": 15.0}),
    ("coulomb_friction", 31, 30.0, {"coulomb_friction": 25.0}),
    ("encoder_quantization", 31, 30.0, {"encoder_quantization": 1.2}),
]


@pytest.mark.long
@pytest.mark.parametrize(("cause", "seed", "duration_s", "causes"), LARGE, ids=str)
def test_large_effects_keep_their_name_and_size(cause, seed, duration_s, causes):
    findings = judged(replace(recipe(cause, seed, duration_s), causes=causes)).findings
    the_cause_is_named(findings, cause)
    ((name, value),) = causes.items()
    the_value_is_right(findings, name, value, TERMS[name].null or 0.0)


@pytest.mark.long
def test_every_eleventh_position_thrown_aside_is_outliers_and_nothing_else():
    made = recipe("nav_outliers", 31, 180.0)
    findings = judged(
        replace(made, causes={**made.causes, "nav_outliers.share": 0.09})
    ).findings
    the_cause_is_named(findings, "nav_outliers")
