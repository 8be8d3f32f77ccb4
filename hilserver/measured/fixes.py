"""Latitudes and longitudes as a position: metres east and north of the first fix.

The plane touches the ellipsoid of WGS 84 at the first fix of all logs. By way of coordinates about
the centre of the earth this is exact for points of the ellipsoid, and a dozen lines; a library for
it brings all map projections along. Heights are left out: at 500 m above the ellipsoid, distances
come out 0.008 % too short.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from hilserver.arrays import Array
from hilserver.errors import LogError
from hilserver.measured.channels import (
    FIX,
    FIX_LATITUDE,
    FIX_LONGITUDE,
    FIX_STATUS,
    FIX_VARIANCE,
    POSITION,
)
from hilserver.measured.tables import Recording, Stamped
from hilserver.measured.thresholds import FARTHEST_FIX_M, POOR_FIX

EQUATOR_M: Final = 6_378_137.0  # semi-major axis of WGS 84
ECCENTRICITY_2: Final = 0.006_694_379_990_14  # square of its first eccentricity
OF_SATELLITES: Final = (
    "the position was made of latitude and longitude, in metres east and north of the first fix;"
    " its error lasts, so many fixes say hardly more than a few, and it shows no heading"
)
STANDS_M: Final = 1e-4  # receivers print less than the width of a hair


def placed(recordings: Sequence[Recording]) -> list[Recording]:
    """Return recordings with positions in place of their fixes, all in one plane.

    Raises
    ------
    LogError
        If a fix is impossible, far from the others, or the same all the time.
    """
    origin: Array | None = None
    found = []
    for recording in recordings:
        parts = []
        notices = list(recording.notices)
        for part in recording.parts:
            if not set(FIX) & set(part.columns):
                parts.append(part)
                continue
            degrees = _fixes(recording, part, notices)
            known = degrees[np.isfinite(degrees[:, 0])]
            if origin is None and len(known):
                origin = known[0]
                notices.append(OF_SATELLITES)
            plane = degrees if origin is None else east_north_m(degrees, origin)
            # The plane is curved: a receiver that repeats one number moved by a hundredth of a
            # micrometre, and does not seem to repeat it.
            plane = np.round(plane / STANDS_M) * STANDS_M
            if len(known):
                _refuse_implausible(recording, plane)
            else:
                notices.append(
                    f"{recording.path}: contains no fix of the satellites, so there is no position;"
                    " record where the receiver sees the sky"
                )
            others = {n: v for n, v in part.columns.items() if n not in FIX}
            columns = {**others, **dict(zip(POSITION, plane.T, strict=True))}
            parts.append(replace(part, columns=columns))
        is_placed = any(set(FIX) & set(part.columns) for part in recording.parts)
        found.append(
            replace(
                recording,
                parts=parts,
                notices=notices,
                by_satellites=recording.by_satellites or is_placed,
            )
        )
    return found


def east_north_m(degrees: Array, origin: Array) -> Array:
    """Return latitudes and longitudes as metres east and north of one of them, shape (n, 2)."""
    latitude, longitude = np.radians(origin)
    x, y, z = (_from_centre_m(degrees) - _from_centre_m(origin[None, :])).T
    outward = np.cos(longitude) * x + np.sin(longitude) * y
    east = np.cos(longitude) * y - np.sin(longitude) * x
    north = np.cos(latitude) * z - np.sin(latitude) * outward
    return np.stack([east, north], axis=1)


def _from_centre_m(degrees: Array) -> Array:
    """Return points of the ellipsoid in the frame of the earth, shape (n, 3)."""
    latitude, longitude = np.radians(degrees).T
    sine = np.sin(latitude)
    across_m = EQUATOR_M / np.sqrt(1.0 - ECCENTRICITY_2 * sine**2)
    from_axis_m = across_m * np.cos(latitude)
    x = from_axis_m * np.cos(longitude)
    y = from_axis_m * np.sin(longitude)
    return np.stack([x, y, (1.0 - ECCENTRICITY_2) * across_m * sine], axis=1)


def _fixes(recording: Recording, part: Stamped, notices: list[str]) -> Array:
    """Return latitude and longitude of each row, shape (n, 2); NaN where there is no good fix."""
    columns = part.columns
    for name in (FIX_LATITUDE, FIX_LONGITUDE):
        if name not in columns:
            raise LogError(
                f"{recording.path}: {name} must stand beside the other {FIX_LATITUDE.split('.')[0]}"
                " channels, in the same table or topic; map it, too"
            )
    for name in POSITION:
        if any(name in other.columns for other in recording.parts):
            raise LogError(
                f"{recording.path}: the mapping has both {name} and {FIX_LATITUDE}; keep one of"
                " them: a robot has one position"
            )
    degrees = np.stack([columns[FIX_LATITUDE], columns[FIX_LONGITUDE]], axis=1)
    is_there = np.isfinite(degrees).all(axis=1)  # a table has rows without any
    is_lost = ~degrees.any(axis=1)
    if FIX_STATUS in columns:
        is_lost |= columns[FIX_STATUS] < 0.0  # sensor_msgs/NavSatStatus: -1 is no fix
    is_lost &= is_there
    # what a receiver writes without a fix may be no place at all
    largest = np.array([90.0, 180.0])
    wrong = np.flatnonzero((np.abs(degrees) > largest).any(axis=1) & ~is_lost)
    if wrong.size:
        row = int(wrong[0])
        raise LogError(
            f"{recording.path}: sample {row + 1}: latitude {degrees[row, 0]:.9g}, longitude"
            f" {degrees[row, 1]:.9g} is no place on the earth; map degrees, or write the unit, as"
            ' {unit: "1", scale: 1e-7}'
        )
    is_poor = np.zeros_like(is_lost)
    if FIX_VARIANCE in columns:
        variance = columns[FIX_VARIANCE]
        stated = variance[variance > 0.0]  # 0: unknown
        usual = float(np.median(stated)) if stated.size else np.inf
        is_poor = is_there & ~is_lost & (variance > POOR_FIX**2 * usual)
    for count, why in (
        (is_lost.sum(), "without a fix of the satellites"),
        (is_poor.sum(), "whose stated error is several times the usual one"),
    ):
        if count:
            notices.append(
                f"{recording.path}: {count} of {is_there.sum()} positions, {why}, were left out"
            )
    return np.where((is_there & ~is_lost & ~is_poor)[:, None], degrees, np.nan)


def _refuse_implausible(recording: Recording, plane: Array) -> None:
    x, y = plane[np.isfinite(plane[:, 0])].T
    farthest_m = float(np.hypot(x, y).max())
    if farthest_m > FARTHEST_FIX_M:
        raise LogError(
            f"{recording.path}: a fix is {farthest_m / 1000.0:.4g} km from the first one; drive"
            " nearer, or leave wrong fixes out of the log"
        )
    if len(x) > 1 and max(np.ptp(x), np.ptp(y)) < STANDS_M:
        raise LogError(
            f"{recording.path}: the satellites' position never changes: the receiver repeats one"
            " fix; record again with a receiver that updates, or leave it out of the mapping"
        )
