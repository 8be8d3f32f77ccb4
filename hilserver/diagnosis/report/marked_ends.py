"""The plot of runs that end beside their marks, after UMBmark (Borenstein and Feng 1996)."""

import numpy as np

from hilserver.diagnosis.findings.explain import number
from hilserver.diagnosis.report.figures import by_role
from hilserver.diagnosis.report.svg import (
    MARGIN_BOTTOM,
    MARGIN_LEFT,
    MARGIN_RIGHT,
    MARGIN_TOP,
    Figure,
    Plot,
    picture,
    span_of,
)
from hilserver.diagnosis.schema.evidence import MarkedEnds

SIDE = 400.0  # of the square between the axes


def marked_ends(ends: MarkedEnds) -> Figure | None:
    """Draw where the runs of both models end, to scale; None without any."""
    if not len(ends.simulated):
        return None
    models = by_role(ends.simulated, ends.extended)
    far = max(float(abs(places).max()) for _, places in models)
    span = span_of(np.array([-far, far]), margin=0.1)
    width, height = SIDE + MARGIN_LEFT + MARGIN_RIGHT, SIDE + MARGIN_TOP + MARGIN_BOTTOM
    plot = Plot(span, span, "forward [m]", "to the left [m]", width, height)
    said = []
    for role, places in models:
        miss_m = np.hypot(*places.T)
        titles = [f"{role}: {number(float(one), 'm', digits=2)}" for one in miss_m]
        plot.dots(places[:, 0], places[:, 1], role, titles)
        said.append(f"{role} {number(float(miss_m.mean()), 'm', digits=2)}")
    plot.dots(np.zeros(1), np.zeros(1), "measured", ["mark"])
    title = "Where runs end, seen from their marks"
    return Figure(
        picture([plot], title),
        title,
        f"Mean distance from the mark: {', '.join(said)}. Seen as the robot stood at the"
        " beginning of its run.",
    )
