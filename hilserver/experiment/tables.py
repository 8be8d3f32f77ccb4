"""The curves of a report as CSV: logs that 'hilserver' itself reads, and the table of the gaps."""

import csv
import io
from collections.abc import Sequence
from typing import Final

import numpy as np

from hilserver.arrays import Array, Indices
from hilserver.experiment.gaps import KINEMATIC, BesideModels
from hilserver.measured.channels import SPEEDS

POSE: Final = ("pose.x_m", "pose.y_m", "pose.yaw_rad", "velocity.angular_rad_s")
MECH: Final = ("mech.x_m", "mech.y_m", "mech.yaw_rad", "mech.angular_rad_s")
GAPS: Final = ("channel", "curve", "beside", "rms", "largest", "at_the_end", "unit")
ROW_S: Final = 0.01  # between two rows


def files(both: BesideModels) -> dict[str, str]:
    """Return the text of every table by the name of its file."""
    courses = both.courses
    period_s = float(courses.t_s[1] - courses.t_s[0])
    kept = slice(None, None, max(round(ROW_S / period_s), 1))
    t_s = courses.t_s[kept]
    span = courses.span[kept]

    found = {"wheels.csv": as_log(t_s, span, SPEEDS, courses.wheels_rpm[kept])}
    for model, values in both.models.items():
        name = "mechatronic.csv"
        names = MECH
        if model == KINEMATIC:
            name = "kinematic.csv"
            names = POSE
        found[name] = as_log(t_s, span, names, values[kept])
    for channel, shown in both.measured.items():
        table = as_log(shown.t_s, shown.span, (shown.signal,), shown.values)
        found[f"measured_{channel}.csv"] = table

    gaps = io.StringIO()
    writer = csv.writer(gaps, lineterminator="\n")
    writer.writerow(GAPS)
    writer.writerows(both.gaps())
    return found | {"gaps.csv": gaps.getvalue()}


def as_log(t_s: Array, span: Indices, names: Sequence[str], columns: Array) -> str:
    """Return columns, shape (n,) or (n, m), as a table in the form of a log."""
    text = io.StringIO()
    header = ",".join(("t_s", "segment", *names))
    rows = np.column_stack([t_s, span, columns])
    np.savetxt(text, rows, fmt="%.9g", delimiter=",", header=header, comments="")
    return text.getvalue()
