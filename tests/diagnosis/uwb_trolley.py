"""Errors of 24 ultra-wideband ranges against motion capture (recording `uwb_trolley`)."""

from datetime import datetime

import numpy as np

from tests.helpers.recordings import recording

ANCHORS_M = [
    (-3.42, 3.01), (0.00, 3.01), (3.61, 2.98), (3.60, 0.00),
    (3.57, -3.01), (-0.01, -2.97), (-3.47, -2.96), (-3.49, -0.01),
]  # fmt: skip
ANCHOR_HEIGHT_M = 1.04
TAGS_M = [(-0.0689, -0.1423), (-0.0750, 0.1402), (0.2034, 0.1451)]


def range_errors(drive):
    """Stamps (n,) [s] and measured minus true range (n, 24) [m] of a drive, ``fast`` or ``mid``."""
    folder = recording("uwb_trolley")
    t_s, ranges = _read(folder / f"UWB_dynamic_exp_{drive}.csv", skip=0)
    at_s, capture = _read(folder / f"motion_capture_dynamic_exp_{drive}.csv", skip=1)
    forward = np.append(True, np.diff(at_s) > 0.0)
    at_s, capture = at_s[forward], capture[forward]
    inside = np.isfinite(ranges).all(axis=1) & (t_s > at_s[0]) & (t_s < at_s[-1])
    t_s, ranges = t_s[inside], ranges[inside]
    # The quaternion turns about the vertical: its columns are (-, w, z, -).
    heading = np.unwrap(2.0 * np.arctan2(capture[:, 5], capture[:, 4]))
    x, y, z, yaw = (np.interp(t_s, at_s, v) for v in (*capture[:, :3].T, heading))
    true = [
        np.sqrt(
            (x + np.cos(yaw) * ahead - np.sin(yaw) * left - ax) ** 2
            + (y + np.sin(yaw) * ahead + np.cos(yaw) * left - ay) ** 2
            + (z - ANCHOR_HEIGHT_M) ** 2
        )
        for ax, ay in ANCHORS_M
        for ahead, left in TAGS_M
    ]
    return t_s - t_s[0], ranges - np.array(true).T


def _read(path, skip):
    rows = [line.split(",") for line in path.read_text().splitlines()[skip:]]
    stamps = [datetime.strptime(row[0], "%Y-%m-%d %H:%M:%S.%f") for row in rows]
    values = [[float(word) if word else np.nan for word in row[1:]] for row in rows]
    return np.array([(stamp - stamps[0]).total_seconds() for stamp in stamps]) + (
        stamps[0] - stamps[0].replace(hour=0, minute=0, second=0, microsecond=0)
    ).total_seconds(), np.array(values)
