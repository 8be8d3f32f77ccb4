"""Wheels whose angle was recorded and whose speed was not: the speed is how the angle changes."""

from dataclasses import replace

import numpy as np

from hilserver.diagnosis.schema.findings import Finding
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.plant.layout import WHEELS
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.units import RPM_PER_RAD_S


def find(log: MeasuredLog, _: RobotParameters) -> tuple[MeasuredLog, list[Finding]]:
    """Put speeds in the place of angles that stand alone; a notice names the wheels."""
    angles = {f"wheel.{wheel}.angle_rad": f"wheel.{wheel}.speed_rpm" for wheel in WHEELS}
    alone = {a: s for a, s in angles.items() if a in log and s not in log and len(log[a]) > 1}
    if not alone:
        return log, []
    speeds = {speed: _changing(log[angle]) for angle, speed in alone.items()}
    note = f"no speed was recorded of {', '.join(alone)}: it is made of how the angles change"
    log = log.without(alone).with_channels(speeds)
    return replace(log, notices=(*log.notices, note)), []


def _changing(angle: Channel) -> Channel:
    """Return the speed [rpm] between every two samples of a span, in the middle between them."""
    inside = np.flatnonzero(np.diff(angle.span) == 0)
    dt = np.diff(angle.t_s)[inside]
    speed = np.diff(angle.values)[inside] / dt * RPM_PER_RAD_S
    return Channel(angle.t_s[inside] + 0.5 * dt, speed, angle.span[inside])
