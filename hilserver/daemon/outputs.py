"""The newest frame on its way out: to the OPC UA server, to the peers, into the figures."""

import time
from collections.abc import Iterable, Mapping

from hilserver.compiled.histogram import Histogram125
from hilserver.core.control import Control
from hilserver.daemon import figures
from hilserver.daemon.builder import Core
from hilserver.daemon.shadow import Pose, measured_pose
from hilserver.image import Frame
from hilserver.io.world import Part
from hilserver.plant.layout import WHEELS, Parameters

EXPORTED = (
    "pose.x_m",
    "pose.y_m",
    "pose.yaw_rad",
    *(f"wheel.{w}.speed_rpm" for w in WHEELS),
)
"""Outputs that metrics show: few, as each is a time series."""
# also shown, if the mechatronic model runs
OF_THE_BODY = ("mech.gap_m", "mech.gap_yaw_rad")


class PublishedOutputs:
    """What the publish slice shows."""

    def __init__(self, core: Core) -> None:
        # the newest one that was published; None before the first
        self.frame: Frame | None = None
        # from a change of a set-point to the first published output that contains it
        self.end_to_end = Histogram125()
        self._core = core

    def publish(self, control: Control, parts: Iterable[Part]) -> None:
        """Send the plant a heartbeat, take the newest frame and hand it on."""
        image = self._core.image
        gate = self._core.gate
        image.control.heartbeat += 1
        frame = image.latest()
        if frame is None:
            return
        frame.values[self._core.table.slot("sim.state")] = control.state
        self.frame = frame
        for part in parts:
            part.publish(frame)
        received_ns = gate.take_change(frame.latched_rows)
        if received_ns is not None:
            self.end_to_end.observe(time.monotonic_ns() - received_ns)

    def read(self, name: str) -> tuple[float | list[float], int, int]:
        """Return value, status and planned start [ns] of a signal.

        LookupError before the first frame.
        """
        frame = self.frame
        slots = list(self._core.table[name].slots)
        if frame is None:
            raise LookupError("no frame has been published yet")
        values = frame.values[slots].tolist()
        status = int(frame.status[slots].max())
        return values if len(slots) > 1 else values[0], status, frame.planned_ns

    def exported(self) -> Mapping[str, float]:
        """Return the outputs that metrics show; none before the first frame."""
        frame = self.frame
        table = self._core.table
        if frame is None:
            return {}
        names = EXPORTED + tuple(name for name in OF_THE_BODY if name in table)
        return {name: float(frame.values[table.slot(name)]) for name in names}

    def model_gap(self) -> Mapping[str, float]:
        """Return measured minus simulated of every channel for which measured values come in."""
        return figures.model_gap(self._core.gate, self._core.table, self.frame)

    def measured_pose(self) -> Pose | None:
        """Return where the real robot is, None while nothing measures it."""
        core = self._core
        parameters = Parameters.of(core.image.region("p")[0])
        return measured_pose(
            core.gate.newest, core.table, core.image.latest(), parameters
        )
