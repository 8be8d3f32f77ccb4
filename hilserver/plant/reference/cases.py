"""The sizes of the terms in the conformance vectors: one file per term, one with all of them."""

from typing import Final

from hilserver.plant.parameters import FOR_MECANUM_ALONE
from hilserver.plant.terms import TERMS

_UNSET_REFERENCE: Final = {
    "controller_gains.i": 0.4,
    "backlash": 0.02,
    "acceleration_slip": 0.05,
    "traction_slip": 0.1,
    "roller_slip": 0.1,
    "body_lag": 0.05,
    "floor_slope.y": 0.02,
    "surface_change.v": -0.2,
    "wheel_runout.amplitude": 0.01,
    "friction_anisotropy.ratio": 2.24,
    "friction_anisotropy.offset": 0.01,
    "nav_lever_arm.y": -0.05,
    "nav_position_bias.amplitude": 0.2,
    "heading_distortion.a2": 0.05,
}


def cases() -> dict[str, dict[str, float]]:
    """Return the terms of every vector file by its name; the base has none."""
    result: dict[str, dict[str, float]] = {"base": {}}
    for term in TERMS.values():
        if not term.shape:
            size = _UNSET_REFERENCE.get(term.name, term.reference)
            if size is None:
                raise ValueError(
                    f"term {term.name} has no size for its conformance vector"
                )
            result[term.name] = {term.name: size}
    # a few of the 12 samples
    result["nav_outliers.share"] = {"nav_outliers.share": 0.3}
    result["battery_sag_viscous"] = {"battery_sag": 1.0, "viscous_load": 0.05}
    result["everything"] = {
        name: size
        for terms in list(result.values())
        for name, size in terms.items()
        if name not in ("saturation_limit", "setpoint_rate_limit", *FOR_MECANUM_ALONE)
    }
    return result
