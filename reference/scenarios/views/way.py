"""The way over the floor."""

from dataclasses import dataclass

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.report.standalone import HEAD_HEIGHT
from hilserver.diagnosis.report.svg import Plot, span_of
from hilserver.diagnosis.schema.evidence import Path
from hilserver.measured.channels import NAV_X
from hilserver.measured.thresholds import LONGEST_SEGMENT_S
from reference.scenarios.views.case import MODELS, PICTURE_WIDTH, POINTS, Case, Legend
from reference.scenarios.views.stretch import stretch


@dataclass(frozen=True, slots=True)
class Way:
    """The way over the floor, to scale, where the models end farthest apart."""

    def draw(self, case: Case) -> tuple[list[Plot], Legend]:
        """Draw x and y of one stretch whose start is free."""
        tracks = self._tracks(case)
        height = 520.0
        x, y = (
            span_of(*(track[:, i] for track in tracks), margin=0.05) for i in (0, 1)
        )
        plot = Plot(
            x, y, "x [m]", "y [m]", width=PICTURE_WIDTH, height=height, top=HEAD_HEIGHT
        )
        per_x = (x[1] - x[0]) / abs(plot.to_x.last - plot.to_x.first)
        per_y = (y[1] - y[0]) / abs(plot.to_y.last - plot.to_y.first)
        scale = max(per_x, per_y)
        plot.x = _widened(x, scale / per_x)
        plot.y = _widened(y, scale / per_y)
        for (role, words), track in zip(MODELS, tracks, strict=False):
            plot.track(track, role, words, points=POINTS)
        plot.dots(tracks[0][:1, 0], tracks[0][:1, 1], "start", ["start"])
        return [plot], MODELS[: len(tracks)]

    def _tracks(self, case: Case) -> list[Array]:
        way: Path = case.diagnosis.evidence.paths[0]
        t_s = case.series(NAV_X).t_s[: len(way.measured)]
        other = way.measured if way.extended is None else way.extended
        apart = np.hypot(*(other - way.simulated).T)
        begin, end = stretch(case, NAV_X, t_s, apart, LONGEST_SEGMENT_S)
        part = (t_s >= begin) & (t_s <= end)
        tracks = [way.measured, way.simulated, way.extended]
        return [track[part] for track in tracks if track is not None]


def _widened(span: tuple[float, float], factor: float) -> tuple[float, float]:
    middle, half = 0.5 * (span[0] + span[1]), 0.5 * factor * (span[1] - span[0])
    return middle - half, middle + half
