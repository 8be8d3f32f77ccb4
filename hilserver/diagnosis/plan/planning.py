"""A whole plan: the manoeuvre as it is, the better one, and what else to record."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hilserver import __version__
from hilserver.daemon.assembly import Assembly
from hilserver.diagnosis.plan.document import Missing, PlanDocument, Proposed, prospect
from hilserver.diagnosis.plan.manoeuvre import (
    Manoeuvre,
    as_scenario,
    of_log,
    of_scenario,
)
from hilserver.diagnosis.plan.null_log import (
    ALL,
    GROUPS,
    SATELLITES_HZ,
    PlannedRecording,
    Studio,
    path_of,
)
from hilserver.diagnosis.plan.outlook import Outlook, look
from hilserver.diagnosis.plan.pieces import Piece, of_moves, pieces
from hilserver.diagnosis.plan.search import choose, information_of
from hilserver.diagnosis.progress import Report
from hilserver.errors import FailedError
from hilserver.faults.scenario import as_yaml
from hilserver.measured.channels import YAW
from hilserver.measured.machine import machine
from hilserver.measured.reading import read_measured
from hilserver.plant.parameters import RobotParameters

PLAN, SCENARIO = "plan.json", "manoeuvre.yaml"
ROOM_M = (5.0, 5.0)
START = of_moves([(1.0, 0.0, 0.0)])  # the robot stands while people step back
YAML = (".yaml", ".yml")


@dataclass(frozen=True)
class Wish:
    """What is asked for."""

    manoeuvre: Path
    mapping: str | None = None
    # measured signals of the experiment; None: those of the log; all for a scenario
    channels: tuple[str, ...] | None = None
    rate_hz: float = 50.0
    # of the better manoeuvre; None: that of the given one
    duration_s: float | None = None
    satellites_m: float | None = None  # see `PlannedRecording`
    room_m: tuple[float, float] = ROOM_M
    seed: int = 0
    jobs: int = 2


@dataclass(frozen=True)
class Given:
    """The manoeuvre that was handed in."""

    spans: list[Manoeuvre]
    robot: RobotParameters
    channels: tuple[str, ...]
    notices: tuple[str, ...] = ()

    @property
    def duration_s(self) -> float:
        """All spans together."""
        return sum(span.duration_s for span in self.spans)


def plan(
    wish: Wish, assembly: Assembly, report: Report
) -> tuple[PlanDocument, dict[str, str]]:
    """Plan an experiment; return the document and the text of every file by its name.

    Raises
    ------
    LogError, ConfigError
        If the manoeuvre cannot be read.
    FailedError
        If no piece fits into the room or the time.
    """
    given = read(wish, assembly.robot)
    recording = PlannedRecording(wish.channels or given.channels, wish.rate_hz)
    if wish.satellites_m is not None:
        recording = replace(
            recording,
            channels=tuple(name for name in recording.channels if name != YAW),
            navigation_hz=SATELLITES_HZ,
            satellites_m=wish.satellites_m,
        )
    studio = Studio(given.robot, wish.seed, wish.jobs, report)
    now = look(given.spans, recording, studio)
    chosen = _better(
        studio, recording, wish.room_m, wish.duration_s or given.duration_s
    )
    spans = [_joined(chosen)]
    if not _inside(spans, given.robot, wish.room_m):
        raise FailedError(
            f"the pieces drift out of {_sides(wish.room_m)}; increase --room"
        )
    then = look(spans, recording, studio)
    stays = _inside(given.spans, given.robot, wish.room_m)
    fits = stays and given.duration_s <= (wish.duration_s or given.duration_s)
    better = then.score > now.score or not fits
    if not better:
        spans, then = given.spans, now
    leaves = (
        f"{wish.manoeuvre.name} leaves {_sides(wish.room_m)} when started in the middle"
    )
    length_s = sum(s.duration_s for s in spans)
    document = PlanDocument(
        version=__version__,
        config_sha256=assembly.config.sha256,
        seed=wish.seed,
        manoeuvre=wish.manoeuvre.name,
        channels=recording.channels,
        rate_hz=recording.rate_hz,
        navigation_hz=recording.navigation_hz,
        satellites_m=recording.satellites_m,
        room_m=wish.room_m,
        as_planned=prospect(now, given.duration_s),
        proposed=Proposed(
            **dict(prospect(then, length_s)),
            better=better,
            pieces=tuple(piece.name for piece in chosen) if better else (),
            scenario=SCENARIO,
        ),
        missing_channels=_missing(studio, given.spans, recording, now),
        notices=given.notices if stays else (*given.notices, leaves),
    )
    files = {
        SCENARIO: as_yaml(
            as_scenario(spans, f"the best manoeuvre in {length_s:.0f} s")
        ),
        PLAN: document.model_dump_json(by_alias=True, indent=1) + "\n",
    }
    return document, files


def read(wish: Wish, robot: RobotParameters) -> Given:
    """Read the manoeuvre: a scenario by its ending, otherwise a log."""
    if wish.manoeuvre.suffix.lower() in YAML:
        return Given(of_scenario(wish.manoeuvre, robot), robot, ALL)
    log = read_measured([wish.manoeuvre], wish.mapping)
    robot = machine(log, robot)
    return Given(
        of_log(log, robot),
        robot,
        tuple(name for name in ALL if name in log) or ALL,
        log.notices,
    )


def _better(
    studio: Studio,
    recording: PlannedRecording,
    room_m: tuple[float, float],
    duration_s: float,
) -> list[Piece]:
    left_s = duration_s - START.duration_s
    able = [p for p in pieces(studio.robot, room_m) if p.manoeuvre.duration_s <= left_s]
    if not able:
        raise FailedError(
            f"no piece fits into {duration_s:.3g} s and {_sides(room_m)};"
            " increase --duration or --room"
        )
    known = information_of(able, recording, studio)
    if not any(stage.directions for stage in known):
        raise FailedError("these channels show no effect: record the wheel speeds, too")
    return choose(able, known, left_s, studio.report)


def _joined(chosen: Sequence[Piece]) -> Manoeuvre:
    whole = START
    for piece in chosen:
        whole = whole.then(piece.manoeuvre)
    return whole


def _inside(
    spans: Sequence[Manoeuvre], robot: RobotParameters, room_m: tuple[float, float]
) -> bool:
    """Return whether the model stays in the room when each span begins in its middle."""
    return all(
        np.abs(x).max() <= 0.5 * room_m[0] and np.abs(y).max() <= 0.5 * room_m[1]
        for x, y, _ in path_of(spans, robot)
    )


def _sides(room_m: tuple[float, float]) -> str:
    return f"{room_m[0]:g} m x {room_m[1]:g} m"


def _missing(
    studio: Studio,
    spans: Sequence[Manoeuvre],
    recording: PlannedRecording,
    now: Outlook,
) -> tuple[Missing, ...]:
    """Return what each channel that is not recorded would add."""
    found = []
    for channel, signals in GROUPS.items():
        absent = tuple(n for n in signals if n not in recording.channels)
        if not absent:
            continue
        more = tuple(n for n in ALL if n in recording.channels or n in absent)
        then = look(spans, replace(recording, channels=more), studio)
        shows = tuple(c for c in then.shown if c not in now.shown)
        before = {c for group in now.groups for c in group}
        separates = tuple(c for c in then.named if c in before)
        found.append(
            Missing(channel=channel, signals=absent, shows=shows, separates=separates)
        )
    return tuple(found)
