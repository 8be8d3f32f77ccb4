"""Quantities over something else than time: heading, horizon, run, speed."""

from dataclasses import dataclass

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.replay.drive_stage import DriveStage
from hilserver.diagnosis.report.standalone import HEAD_HEIGHT
from hilserver.diagnosis.report.svg import Plot, span_of
from hilserver.identify.rotation import identify_rotation
from hilserver.measured.channels import DUTIES, SPEEDS, YAW
from hilserver.measured.data import MeasuredLog
from reference.scenarios.views.case import (
    HEIGHT,
    MODELS,
    PICTURE_WIDTH,
    Case,
    Legend,
    axes,
)


@dataclass(frozen=True, slots=True)
class AgainstHeading:
    """The mean residual of the heading in every direction that the robot looks to."""

    bins: int = 36

    def draw(self, case: Case) -> tuple[list[Plot], Legend]:
        """Draw what both models leave, over one turn."""
        s = case.series(YAW)
        edges = np.linspace(-np.pi, np.pi, self.bins + 1)
        place = np.digitize(np.angle(np.exp(1j * s.measured)), edges) - 1
        middle = 0.5 * (edges[1:] + edges[:-1])
        curves = [("simulated", s.measured - s.simulated)]
        if s.extended is not None:
            curves.append(("extended", s.measured - s.extended))
        means = {
            role: np.array([left[place == k].mean() for k in range(self.bins)])
            for role, left in curves
        }
        plot = axes(
            edges,
            list(means.values()),
            "measured heading [rad]",
            "mean residual [rad]",
            HEIGHT,
            HEAD_HEIGHT,
        )
        plot.level(0.0)
        for role, mean in means.items():
            plot.line(middle, mean, role, role)
            plot.dots(middle, mean, role, [f"{v:.4f} rad" for v in mean])
        words = {
            "simulated": "measured minus simulated",
            "extended": "measured minus extended",
        }
        return [plot], [(role, words[role]) for role in means]


@dataclass(frozen=True, slots=True)
class OverHorizon:
    """The error at the end of a free run over its length."""

    quantity: str
    words: str
    unit: str

    def draw(self, case: Case) -> tuple[list[Plot], Legend]:
        """Draw the mean absolute errors of both models."""
        rows = case.diagnosis.evidence.gain_by_horizon
        gains = [row.gain for row in rows if row.quantity == self.quantity]
        t = np.array([g.horizon_s for g in gains])
        curves = {
            "simulated": np.array([g.before for g in gains]),
            "extended": np.array([g.after for g in gains]),
        }
        label = f"{self.words} [{self.unit}]"
        y = span_of(*curves.values(), np.zeros(1))
        plot = Plot(
            span_of(t),
            y,
            "free run [s]",
            label,
            width=PICTURE_WIDTH,
            height=HEIGHT,
            top=HEAD_HEIGHT,
        )
        for role, error in curves.items():
            plot.line(t, error, role, role)
            plot.dots(t, error, role, [f"{v:.3g} {self.unit}" for v in error])
        return [plot], MODELS[1:]


@dataclass(frozen=True, slots=True)
class TurnGains:
    """K_om of every run with its interval, of both groups."""

    groups: tuple[str, str]
    with_model: bool = True

    def draw(self, case: Case) -> tuple[list[Plot], Legend]:
        """Draw a dot for each run beside the value of the configuration."""
        runs = (*case.logs, *case.against)
        found = [identify_rotation(log, case.robot).unsteady for log in runs]
        value = np.array([e.value for e in found])
        low, high = (
            np.array([e.value if e.ci95 is None else e.ci95[i] for e in found])
            for i in (0, 1)
        )
        x = np.arange(1.0, len(runs) + 1.0)
        model = np.full(2, case.robot.k_om) if self.with_model else None
        y = span_of(low, high, model, margin=0.12)
        plot = Plot(
            (0.5, len(runs) + 0.5),
            y,
            "run",
            "K_om [1/m]",
            width=PICTURE_WIDTH,
            height=HEIGHT,
            top=HEAD_HEIGHT,
        )
        if model is not None:
            plot.line(np.array(plot.x), model, "simulated", "configured")
        first = len(case.logs)
        for rows, role in (
            (slice(0, first), "measured"),
            (slice(first, None), "extended"),
        ):
            plot.whiskers(x[rows], low[rows], high[rows], role)
            plot.dots(x[rows], value[rows], role, [f"{v:.3f} 1/m" for v in value[rows]])
            mean = float(value[rows].mean())
            plot.line(
                x[rows], np.full(len(x[rows]), mean), role, f"mean {mean:.3f} 1/m"
            )
        legend = [
            ("measured", f"measured, {self.groups[0]}, and mean"),
            ("extended", f"measured, {self.groups[1]}, and mean"),
        ]
        return [plot], [
            *legend,
            ("simulated", "simulated"),
        ] if self.with_model else legend


@dataclass(frozen=True, slots=True)
class DutyOverSpeed:
    """The duty that a steady speed takes, in the air and on the floor."""

    steady_s: float = 0.5
    bins: int = 24

    def draw(self, case: Case) -> tuple[list[Plot], Legend]:
        """Draw mean duties of both logs and of the configured plant."""
        air, floor = (self._measured(log) for log in (case.log, case.against[0]))
        simulated = self._simulated(case)
        curves = {"measured": air, "extended": floor, "simulated": simulated}
        x = span_of(*(c[0] for c in curves.values()))
        y = span_of(*(c[1] for c in curves.values()))
        plot = Plot(
            x,
            y,
            "wheel speed [rpm]",
            "duty [%]",
            width=PICTURE_WIDTH,
            height=HEIGHT,
            top=HEAD_HEIGHT,
        )
        for role, (speed, duty) in curves.items():
            plot.line(speed, duty, role, role)
            plot.dots(speed, duty, role, [f"{d:.3g} %" for d in duty])
        return [plot], [
            ("measured", "measured, in the air"),
            ("extended", "measured, on the floor"),
            ("simulated", "simulated"),
        ]

    def _measured(self, log: MeasuredLog) -> tuple[Array, Array]:
        speed, duty = log[SPEEDS[0]], log[DUTIES[0]]
        return self._means(
            speed.t_s, speed.values, np.interp(speed.t_s, duty.t_s, duty.values)
        )

    def _simulated(self, case: Case) -> tuple[Array, Array]:
        stage = DriveStage(case.log, case.robot, block_s=5.0)
        _, speed, duty = stage.simulate({})
        return self._means(stage.segments.times(0), speed[:, 0], duty[:, 0])

    def _means(self, t_s: Array, speed: Array, duty: Array) -> tuple[Array, Array]:
        """Return mean speed and duty of every bin in which the speed has stood still."""
        back = np.searchsorted(t_s, t_s - self.steady_s)
        steady = np.abs(speed - speed[back]) < 0.5
        steady[1:] &= steady[:-1]
        speed, duty = speed[steady], duty[steady]
        edges = np.linspace(speed.min(), speed.max() + 1e-9, self.bins + 1)
        place = np.digitize(speed, edges) - 1
        kept = [place == k for k in range(self.bins) if (place == k).sum() >= 10]
        return (
            np.array([np.median(speed[rows]) for rows in kept]),
            np.array([np.median(duty[rows]) for rows in kept]),
        )
