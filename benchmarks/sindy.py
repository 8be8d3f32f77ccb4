"""PySINDy as a rival of the diagnosis: a sparse model of the residual velocities of the body.

Sequentially thresholded least squares (Brunton et al., PNAS 113, 2016) for each velocity alone. The
threshold is the smallest effect [m/s or rad/s, RMS] that a term may have: the largest one whose
held-out error is within one standard error of the minimum. It only sees velocities: it has no terms
for causes of the drive, for regions or for outliers.
"""

import warnings
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.body_velocities import AHEAD, TURN, BodyVelocities
from hilserver.arrays import Array
from hilserver.diagnosis.regression.gain import held_out
from hilserver.diagnosis.regression.stages import Prepared
from hilserver.errors import FailedError

Pair = tuple[str, str]

THRESHOLDS: Final = np.geomspace(3e-4, 0.3, 13)
PARTS: Final = 6
"""Number of parts that are held out in turn to choose a threshold."""


def _of(*pairs: str) -> frozenset[Pair]:
    """Return velocity and term of each ``velocity: term``."""
    split = (pair.split(": ") for pair in pairs)
    return frozenset((velocity, term) for velocity, term in split)


CAUSES: Final[Mapping[str, frozenset[Pair]]] = {
    "wheel_radius": _of("ahead: v", "turn: om", "gyro: om"),
    "wheel_radius_difference": _of("ahead: om", "turn: v", "gyro: v"),
    "encoder_scale": _of(
        "ahead: v", "ahead: om", "turn: v", "turn: om", "gyro: v", "gyro: om"
    ),
    "rotation_gain": _of("turn: om", "gyro: om"),
    "rotation_gain_speed": _of("turn: |v| om", "gyro: |v| om"),
    "rotation_gain_radius": _of("turn: om", "turn: |v| om", "gyro: om", "gyro: |v| om"),
    "longitudinal_slip": _of("ahead: v |om|"),
    "acceleration_slip": _of("ahead: v |dv|"),
    "traction_slip": _of("ahead: v"),
    "body_lag": _of("ahead: dv", "turn: dom", "gyro: dom"),
    "side_slip": _of("aside: v om"),
    "icr_offset": _of("aside: om"),
    "wheel_misalignment": _of("aside: v"),
    "floor_slope": _of("ahead: cos", "ahead: sin", "aside: cos", "aside: sin"),
    "nav_frame_yaw": _of("aside: v"),
    "nav_lever_arm": _of("ahead: om", "aside: om"),
    "nav_latency": _of("ahead: dv", "aside: v om"),
    "yaw_latency": _of("turn: dom", "aside: v om"),
    "nav_scale": _of("ahead: v"),
    "heading_distortion": _of(
        "turn: om cos", "turn: om sin", "aside: v cos", "aside: v sin"
    ),
    "gyro_bias": _of("gyro: 1"),
    "gyro_scale": _of("gyro: om"),
    "imu_latency": _of("gyro: dom"),
}
"""The terms that each cause produces, to first order."""


def library() -> Any:
    """Return `pysindy`.

    Raises
    ------
    FailedError
        If it is not installed.
    """
    try:
        import pysindy  # noqa: PLC0415 (an extra, slow to import)
    except ImportError:
        msg = (
            "the rivals of the diagnosis need pysindy: pip install 'hilserver[rivals]'"
        )
        raise FailedError(msg) from None
    return pysindy


def sindy(prepared: Prepared) -> Array:
    """Return the held-out prediction of all samples of a pose."""
    body = BodyVelocities(prepared)
    columns = _stacked(terms(body, headed=False))
    predictions = []
    for test in (0, 1):
        train = body.fold != test
        left = {
            key: columns @ sparse(columns[train], values[train], body.block[train])
            for key, values in body.left.items()
        }
        predictions.append(body.predicted(left))
    return held_out(prepared.problem, predictions)


def said(prepared: Prepared) -> list[list[str]]:
    """Return the causes that PySINDy's terms indicate, in groups with the same terms."""
    body = BodyVelocities(prepared)
    known = terms(body, headed=True)
    names, columns = list(known), _stacked(known)
    found = set()
    for key, values in body.left.items():
        weights = sparse(columns, values, body.block)
        found |= {(key, names[k]) for k in np.flatnonzero(weights)}
    return mapped(found, frozenset(body.left))


def mapped(found: set[Pair], velocities: frozenset[str]) -> list[list[str]]:
    """Return causes that explain the terms, first those that explain most and add fewest others.

    Causes with the same terms are one group. A cause that adds as many terms as it explains is not
    returned.
    """
    makes = {
        c: frozenset(p for p in pairs if p[0] in velocities)
        for c, pairs in CAUSES.items()
    }
    groups: list[list[str]] = []
    left = set(found)
    while left:
        worth = {
            c: len(pairs & left) - len(pairs - found)
            for c, pairs in makes.items()
            if pairs
        }
        most = max(worth.values())
        if most <= 0:
            break
        best = [c for c in worth if worth[c] == most]
        fewest = min(len(makes[c]) for c in best)
        first = next(makes[c] for c in best if len(makes[c]) == fewest)
        groups.append([c for c in best if makes[c] == first])
        left -= first
    return groups


def terms(body: BodyVelocities, *, headed: bool) -> dict[str, Array]:
    """Return the terms of the replay's motion by name, each of shape (n,).

    Parameters
    ----------
    headed : bool
        Include terms of the heading in the room, which indicate a cause but cannot predict.
    """
    v, om = body.replayed[AHEAD], body.replayed[TURN]
    dv, dom = body.rate(v), body.rate(om)
    found = {
        "1": np.ones_like(v), "v": v, "om": om, "dv": dv, "dom": dom,
        "v |om|": v * np.abs(om), "v om": v * om, "|v| om": np.abs(v) * om,
        "v |dv|": v * np.abs(dv),
    }  # fmt: skip
    if headed:
        cos, sin = np.cos(body.yaw_rad), np.sin(body.yaw_rad)
        found |= {"cos": cos, "sin": sin, "v cos": v * cos, "v sin": v * sin}
        found |= {"om cos": om * cos, "om sin": om * sin}
    return found


def _stacked(known: Mapping[str, Array]) -> Array:
    return np.stack(list(known.values()), axis=1)


def sparse(columns: Array, left: Array, block: NDArray[np.int64]) -> Array:
    """Return the weight of each term, mostly 0, shape (terms,)."""
    scale = np.sqrt(np.mean(columns**2, axis=0)) + 1e-12
    columns = columns / scale
    _, number = np.unique(block, return_inverse=True)
    part = number % PARTS
    missed = np.array(
        [
            [
                np.mean((left[part == k] - columns[part == k] @ weights) ** 2)
                for weights in _fits(columns[part != k], left[part != k])
            ]
            for k in range(PARTS)
            if (part == k).any() and (part != k).any()
        ]
    )
    more = missed - missed[:, [np.argmin(missed.mean(axis=0))]]
    within = more.mean(axis=0) <= more.std(axis=0, ddof=1) / np.sqrt(len(missed))
    chosen = int(np.flatnonzero(within)[-1])
    return np.asarray(_fits(columns, left)[chosen] / scale)


def _fits(columns: Array, left: Array) -> list[Array]:
    """Return the weights for every threshold."""
    optimizer = library().STLSQ
    found = []
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sparsity parameter is too big")
        for threshold in THRESHOLDS:
            model = optimizer(threshold=threshold).fit(columns, left[:, None])
            found.append(np.asarray(model.coef_)[0])
    return found
