"""A file of marks on the floor, as the reference of a log without a pose."""

from pathlib import Path
from typing import Final

import numpy as np
from pydantic import Field

from hilserver.config.loading import load, place
from hilserver.config.section import Section
from hilserver.errors import ConfigError, LogError
from hilserver.measured.channels import GYRO, POSITION, YAW
from hilserver.measured.data import MeasuredLog
from hilserver.measured.floor_marks import FloorMark, PlacedMark
from hilserver.measured.thresholds import COARSE_MARK_M

MOST_MARKS: Final = 5000


class MarksFile(Section):
    """A file of marks."""

    marks: tuple[FloorMark, ...] = Field(min_length=1, max_length=MOST_MARKS)


def with_marks(log: MeasuredLog, path: Path) -> MeasuredLog:
    """Return a log without a pose, with the marks of a file as its reference.

    Raises
    ------
    LogError
        If the file cannot be read, a mark does not fit the log, or the log has a pose of its own.
    """
    posed = next((name for name in (*POSITION, YAW) if name in log), None)
    if posed is not None:
        raise LogError(
            f"{path}: the log has a pose of its own ({posed}), which shows more than marks; leave"
            " out --marks, or leave the pose out of the mapping"
        )
    if not path.exists():
        raise LogError(f"{path}: no such file; name a file of marks, as marks.yaml")

    try:
        marks = load(path, MarksFile).marks
    except ConfigError as error:
        raise LogError(str(error)) from None
    placed = []
    complaints = []
    for index, mark in enumerate(marks):
        try:
            placed.append(PlacedMark(_run_of(log, mark), mark))
        except ValueError as error:
            complaints.append(f"{place(path, ('marks', index))}{error}")
    if complaints:
        raise LogError("\n".join(complaints[:20]))

    log = log.with_marks(placed)
    coarsest_m = max(mark.sd_m for mark in marks)
    if coarsest_m > COARSE_MARK_M:
        log = log.noticed(
            f"{path}: a mark has sd_m {coarsest_m:g}, so coarse that it hardly shows anything;"
            " write metres, as 0.005 for 5 mm"
        )
    if GYRO not in log:
        return log
    notice = (
        "the turn rate is not used: beside marks, the motion is judged by them alone"
    )
    return log.without([GYRO]).noticed(notice)


def _run_of(log: MeasuredLog, mark: FloorMark) -> int:
    """Return the span that contains a mark; ValueError says why none does.

    A run lasts until the next row would have come, but a mark inside another one is of that.
    """
    spans, row_s = log.spans, _row_s(log)
    known = {span.number_recorded for span in spans}
    if mark.segment is not None and mark.segment not in known:
        numbers = f"{min(known)} to {max(known)}"
        raise ValueError(f"segment {mark.segment} is not in the log; it has {numbers}")
    for more_s in (0.0, row_s):
        inside = [
            index
            for index, span in enumerate(spans)
            if span.start_s - more_s <= mark.t_s <= span.end_s + more_s
            and mark.segment in (None, span.number_recorded)
        ]
        if inside:
            break
    if not inside:
        asked = [s for s in spans if mark.segment in (None, s.number_recorded)]
        first_s = min(span.start_s for span in asked)
        last_s = max(span.end_s for span in asked)
        of_what = "log" if mark.segment is None else f"log's segment {mark.segment}"
        raise ValueError(
            f"t_s {mark.t_s:g} is in no run of the {of_what}, whose times go from {first_s:g} to"
            f" {last_s:g} s; write the time that the log has there"
        )
    if len(inside) > 1:
        raise ValueError(
            f"t_s {mark.t_s:g} is in {len(inside)} runs of the log; name one of them, as"
            f" segment: {spans[inside[0]].number_recorded}"
        )

    span = spans[inside[0]]
    other_s = mark.other_t_s
    if other_s is None:
        return inside[0]
    if not span.start_s - row_s <= other_s <= span.end_s + row_s:
        raise ValueError(
            f"the time {other_s:g} that it refers to is outside its run, which goes from"
            f" {span.start_s:g} to {span.end_s:g} s; refer to a time of the same run"
        )
    if other_s == mark.t_s:
        raise ValueError("it refers to its own time; refer to another one")
    return inside[0]


def _row_s(log: MeasuredLog) -> float:
    """Return the usual time between two rows."""
    steps_s = [
        np.diff(channel.t_s)[np.diff(channel.span) == 0]
        for channel in log.channels.values()
    ]
    return min((float(np.median(own)) for own in steps_s if len(own)), default=0.0)
