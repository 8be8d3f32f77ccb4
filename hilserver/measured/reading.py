"""Logs of any accepted kind, as measured data of one machine."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from hilserver.arrays import Indices
from hilserver.errors import LogError
from hilserver.logs.bag_reader import is_own_bag
from hilserver.logs.reading import is_bag_of_ros, refuse_others
from hilserver.measured.bag import is_bag, read_bag
from hilserver.measured.bag_proposal import refuse_unmapped
from hilserver.measured.channels import (
    DEMANDS,
    DUTY_COMMANDS,
    MODE,
    SETPOINTS,
    SPEEDS,
    TWIST,
)
from hilserver.measured.corrections import OF_A_MAP, cut_at_corrections
from hilserver.measured.data import Channel, LogSource, MeasuredLog, Span
from hilserver.measured.fixes import placed
from hilserver.measured.frames import Sampling
from hilserver.measured.mapping import LogMapping, load_mapping
from hilserver.measured.odometry import with_wheels
from hilserver.measured.own_odometry import without_own_odometry
from hilserver.measured.pauses import cut_at_pauses, without_jumps
from hilserver.measured.tables import (
    Recording,
    Stamped,
    read_mapped,
    read_own,
    read_own_parquet,
    refuse_foreign,
)
from hilserver.measured.thresholds import (
    LATEST_S,
    LONGEST_LOG_S,
    SHORTEST_LOG_S,
    SHORTEST_SEGMENT_S,
    SLOWEST_ROWS_S,
    TURNING_RPM,
)
from hilserver.plant.layout import MODE_TWIST


def read_measured(
    paths: Sequence[Path],
    mapping: Path | str | None = None,
    sampling: Sampling | None = None,
) -> MeasuredLog:
    """Read the logs of one machine and pool them.

    Parameters
    ----------
    paths : sequence of Path
        CSV, MCAP, Parquet, or ROS 2 bags (a file or the folder).
    mapping : Path or str, optional
        A mapping file or the name of a built-in one; without it columns are signal names.
    sampling : Sampling, optional
        The sampling of the configuration in use, for frames of the daemon that do not carry their
        own configuration.

    Raises
    ------
    LogError
        One sentence that names file, row, column and remedy.
    """
    table = None if mapping is None else load_mapping(mapping)
    recordings = placed([_read(path, table, sampling) for path in paths])
    if not recordings:
        raise LogError("no log given; name at least one")
    sources = tuple(LogSource(_shown(path), _sha256(path)) for path in paths)
    _refuse_others(paths, sources, recordings)
    notices: list[str] = []
    for recording in recordings:
        notices += recording.notices
    log = MeasuredLog(
        sources=sources,
        channels={},
        spans=(),
        has_stamps=all(recording.has_stamps for recording in recordings),
        plant={} if table is None else table.plant_keys,
        notices=tuple(notices),
        on_ticks=any(recording.on_ticks for recording in recordings),
        pose_errors_last=any(recording.by_satellites for recording in recordings)
        or (table is not None and table.reference.by == "map"),
    )
    whole = without_jumps(cut_at_pauses(_pool(log, recordings)))
    pooled = with_wheels(whole, table)
    if table is not None and table.reference.by == "map":
        pooled = cut_at_corrections(without_own_odometry(pooled)).noticed(OF_A_MAP)
    _refuse_lengths(paths[0], [span.end_s - span.start_s for span in pooled.spans])
    for path, recording in zip(paths, recordings, strict=True):
        _refuse_slow(path, recording)
    return pooled


def _refuse_slow(path: Path, recording: Recording) -> None:
    """Refuse rows so far apart that their unit must be wrong, or nothing of a drive is visible."""
    usual: list[float] = []
    for part in recording.parts:
        within = np.diff(part.segment) == 0
        if within.any():
            usual.append(float(np.median(np.diff(part.t_s)[within])))
    usual_s = min(usual, default=0.0)
    if recording.has_stamps and usual_s > SLOWEST_ROWS_S:
        raise LogError(
            f"{path}: its rows are {usual_s:.3g} s apart, too far to show the motion of a robot;"
            f" write seconds, or give the unit in a mapping, as time: {{unit: ms}}"
        )


def _refuse_lengths(path: Path, lengths_s: Sequence[float]) -> None:
    """Refuse lengths that are too long or too short for a diagnosis."""
    longest_s = max(lengths_s)
    total_s = sum(lengths_s)
    if total_s > LONGEST_LOG_S:
        raise LogError(
            f"{path}: lasts {total_s:.6g} s; a diagnosis accepts {LONGEST_LOG_S:g} s at most:"
            " cut out a part, or correct the unit of its time"
        )
    if longest_s < SHORTEST_SEGMENT_S:
        raise LogError(
            f"{path}: the longest of {len(lengths_s)} segments lasts {longest_s:.3g} s; a"
            f" diagnosis needs {SHORTEST_SEGMENT_S:g} s without a pause: number runs, not rows"
        )


def _read(
    path: Path, mapping: LogMapping | None, sampling: Sampling | None
) -> Recording:
    try:
        refuse_others(path)
        recording = _by_kind(path, mapping, sampling)
    except OSError as error:
        reason = error.strerror or "cannot be read"
        raise LogError(f"{path}: {reason.lower()}") from None
    columns = [values for part in recording.parts for values in part.columns.values()]
    if not any(np.isfinite(values).any() for values in columns):
        raise LogError(
            f"{path}: contains no samples of any signal; record some, or map its columns"
        )
    usual_s = max(np.median(np.abs(part.t_s)) for part in recording.parts)
    if usual_s > LATEST_S:
        raise LogError(
            f"{path}: its times are about {usual_s:.3g} s, impossible for a recording; write"
            f" seconds, or give the unit in a mapping, as time: {{unit: ns}}"
        )
    spans, _ = _spans(recording, 0)
    seconds = sum(span.end_s - span.start_s for span in spans)
    if seconds < SHORTEST_LOG_S:
        raise LogError(
            f"{path}: contains only {seconds:.3g} s; a diagnosis needs at least"
            f" {SHORTEST_LOG_S:g} s"
        )
    return recording


def _by_kind(
    path: Path, mapping: LogMapping | None, sampling: Sampling | None
) -> Recording:
    if mapping is None:
        if is_bag_of_ros(path) and not is_own_bag(path):
            refuse_unmapped(path)
        refuse_foreign(path)
        read = read_own_parquet if path.suffix == ".parquet" else read_own
        return read(path, sampling)
    if mapping.is_for_bags and is_bag(path):
        return read_bag(path, mapping)
    if mapping.is_for_bags:
        raise LogError(
            f"{path}: the mapping names topics of a bag, but this is a table; name columns"
        )
    if is_bag(path):
        raise LogError(
            f"{path}: the mapping names columns, but this is a bag; name topic and field"
        )
    if path.suffix not in (".csv", ".parquet"):
        raise LogError(
            f"{path}: not a readable table; supported are .csv and .parquet, uncompressed; a table"
            " of text is read as well if its name ends in .csv"
        )
    return read_mapped(path, mapping)


def _refuse_others(
    paths: Sequence[Path], sources: Sequence[LogSource], recordings: Sequence[Recording]
) -> None:
    """Refuse what cannot be pooled: the same log twice, and recordings of different machines."""
    logs = list(zip(paths, sources, recordings, strict=True))
    for index, (path, source, recording) in enumerate(logs):
        for other_path, other_source, other in logs[:index]:
            if source.sha256 == other_source.sha256:
                raise LogError(
                    f"{path}: is the same log as {other_path}; name it only once"
                )
            machines = {other.machine, recording.machine} - {None}
            if len(machines) > 1:
                raise LogError(
                    f"{path}: was recorded with a different plant from that of {other_path};"
                    " pool only logs of one machine, or use --each"
                )


def _shown(path: Path) -> str:
    """Return the name of a log in reports, which travel: not its path on this computer."""
    if not path.is_absolute():
        return str(path)
    here = Path.cwd()
    return str(path.relative_to(here)) if path.is_relative_to(here) else path.name


def _sha256(path: Path) -> str:
    digest = hashlib.sha256()
    files = [path]
    if path.is_dir():
        files = sorted(file for file in path.iterdir() if file.is_file())
    for file in files:
        with file.open("rb") as opened:
            while chunk := opened.read(1 << 20):
                digest.update(chunk)
    return digest.hexdigest()


def _pool(log: MeasuredLog, recordings: Sequence[Recording]) -> MeasuredLog:
    """Return `log` with the recordings one after the other and continuous span numbers."""
    spans: list[Span] = []
    pieces: dict[str, list[Channel]] = {}
    for recording in recordings:
        first_number = max((span.number for span in spans), default=-1) + 1
        own, rows = _spans(recording, first_number if spans else 0)
        for part, span in zip(recording.parts, rows, strict=True):
            for name, piece in _channels(part, span + len(spans)).items():
                pieces.setdefault(name, []).append(piece)
        spans += own
    channels = _commanded({name: _joined(found) for name, found in pieces.items()})
    log = replace(log, channels=channels, spans=tuple(spans))
    if not _at_zero(channels) or not _turning(channels):
        return log
    return log.without(SETPOINTS).noticed(
        "the set-points of the wheels are zero all the time while the wheels turn: something else"
        f" commanded them, as a twist; record {DEMANDS[0]} and the others, which are what the"
        " wheels were asked for in every mode"
    )


def _commanded(channels: Mapping[str, Channel]) -> dict[str, Channel]:
    """Return the channels with what the wheels were asked to do as set-points, if nothing else is.

    The demand was computed, not measured: nobody judges it. Recorded commands come first, as they
    were not yet limited and delayed.
    """
    found = {name: channel for name, channel in channels.items() if name not in DEMANDS}
    by_twist = MODE in found and (found[MODE].values == MODE_TWIST).any()
    asked = all(name in channels for name in DEMANDS)
    known = found.keys() & {*TWIST, *DUTY_COMMANDS}
    by_wheel = found.keys() >= set(SETPOINTS) and not by_twist and not _at_zero(found)
    if not asked or known or by_wheel:
        return found
    found.pop(MODE, None)
    for setpoint, demand in zip(SETPOINTS, DEMANDS, strict=True):
        found[setpoint] = channels[demand]
    return found


def _at_zero(channels: Mapping[str, Channel]) -> bool:
    """Return whether the wheels have set-points, and never one that is not zero."""
    return channels.keys() >= set(SETPOINTS) and not any(
        channels[name].values.any() for name in SETPOINTS
    )


def _turning(channels: Mapping[str, Channel]) -> bool:
    """Return whether a wheel turns half of the time or more."""
    speeds = (abs(channels[name].values) for name in SPEEDS if name in channels)
    return any(len(own) and float(np.median(own)) > TURNING_RPM for own in speeds)


def _spans(recording: Recording, offset: int) -> tuple[list[Span], list[Indices]]:
    """Return the spans of a file and, for each part, the span of every row.

    A table begins a span where segment or block changes; the parts of a bag share one.
    """
    if len(recording.parts) > 1:
        start_s = min(float(part.t_s[0]) for part in recording.parts)
        end_s = max(float(part.t_s[-1]) for part in recording.parts)
        lengths = [len(part.t_s) for part in recording.parts]
        rows = [np.zeros(length, dtype=np.int64) for length in lengths]
        return [Span(offset, None, start_s, end_s)], rows
    (part,) = recording.parts
    block = np.zeros_like(part.segment) if part.block is None else part.block
    begins = (np.diff(part.segment) != 0) | (np.diff(block) != 0)
    starts = np.flatnonzero(np.append(True, begins)[: len(part.t_s)])
    ends = np.append(starts[1:], len(part.t_s))

    numbers = part.segment[starts]
    runs = numbers[np.flatnonzero(np.diff(numbers, prepend=numbers[:1] - 1))]
    unique, counts = np.unique(runs, return_counts=True)
    if (counts > 1).any():
        number = int(unique[counts > 1][0])
        raise LogError(
            f"{recording.path}: column 'segment': segment {number} begins twice; give each run"
            " its own number"
        )

    spans = []
    for first, end in zip(starts, ends, strict=True):
        number = offset + int(part.segment[first])
        own_block = None if part.block is None else int(part.block[first])
        start_s = float(part.t_s[first])
        end_s = float(part.t_s[end - 1])
        spans.append(Span(number, own_block, start_s, end_s))
    return spans, [np.repeat(np.arange(len(starts)), ends - starts)]


def _channels(part: Stamped, span: Indices) -> Mapping[str, Channel]:
    found = {}
    begins_s = part.t_s[np.searchsorted(span, span)] if part.age_s else part.t_s
    for name, values in part.columns.items():
        t_s = part.t_s
        sampled = np.isfinite(values)
        if name in part.age_s:
            t_s = t_s - part.age_s[name]
            sampled &= t_s >= begins_s
        if sampled.all():
            found[name] = Channel(t_s, values, span)
        elif sampled.any():
            found[name] = Channel(t_s[sampled], values[sampled], span[sampled])
    return found


def _joined(pieces: Sequence[Channel]) -> Channel:
    if len(pieces) == 1:
        return pieces[0]
    return Channel(
        np.concatenate([piece.t_s for piece in pieces]),
        np.concatenate([piece.values for piece in pieces]),
        np.concatenate([piece.span for piece in pieces]),
    )
