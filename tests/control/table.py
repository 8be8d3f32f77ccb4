# ruff: noqa: E501 - a table reads best with a row in a line
"""The control matrix: what has to become of the robot, for every source and every event.

`test_matrix` executes the table; ``docs/reference/control-matrix.md`` prints it
(``python -m tests.control.table``).
"""

from collections.abc import Iterator, Mapping
from typing import Final

SOURCES: Final = (
    "peer",
    "opcua",
    "page",
    "ros2",
    "shield",
    "scenario",
    "foxglove",
    "teleop",
)
"""Who drives at first, by the column."""

OUTCOMES: Final[Mapping[str, str]] = {
    "taken": "the other one has control: zero at first, then its set-points, nothing of before",
    "refused": "the other one is refused with a sentence; it goes on as before",
    "before": "zero at first, then the source that had control before (here the peer) drives",
    "nobody": "zero, and nobody drives, although peer, ROS 2 and shield go on offering commands",
    "zero": "zero when its command lapses; it keeps control and drives again when it commands again",
    "off": "zero when its command lapses, the drive is disabled",
    "safe": "the safe state: a ramp to zero, and the drive is disabled",
    "drives": "it goes on as before",
    "start": "zero until Start, although it goes on commanding; then it drives, and keeps control",
    "rest": "zero until it was at rest, without Start; then it drives, and keeps control",
    "anew": "zero at first, and until it commands again, a hand once it was at rest; it keeps control",
    "forced": "the forced value, then its own again; it keeps control",
    "-": "does not exist",
}

EVENTS: Final[Mapping[str, str]] = {
    **{
        f"taken by {other}": f"{other} takes control, or is given it"
        for other in SOURCES
    },
    "given back": "control goes back to the source before",
    "closed": "its user ends it: tab, session, program, line; of a scenario, who started it",
    "cut": "its connection breaks",
    "killed": "its process is killed",
    "silent": "its process stands still, its connections stay open",
    "stopped": "Stop",
    "lock held": "a call in the daemon keeps the interpreter lock for 5 s",
    "paused": "Pause and Start, while it is silent",
    "stepped": "Pause and Step, while it is silent",
    "slowed": "a quarter of the speed, then it is silent",
    "reset": "Reset, while it is silent",
    "snapshot": "LoadSnapshot of a moment at which it drove, while it is silent",
    "overrun": "no thread of the daemon runs for 1.5 s, while it is silent",
    "forced": "Force of what it commands, and Unforce",
    "acknowledged": "Stop, and Reset, while it is silent",
    "held over": "Stop, and Reset, while it goes on commanding",
    "restarted": "the daemon is ended and started again",
}

VARIANTS: Final[Mapping[str, Mapping[str, Mapping[str, object]]]] = {
    "": {"scheduler": {"policy": "skip"}},
    "fallback before": {"control": {"fallback": "before"}},
    "stretch": {"scheduler": {"policy": "stretch"}},
}
"""Sections of the configuration, by what an event has behind its comma."""

# fmt: off
TABLE: Final[Mapping[str, tuple[str, ...]]] = {
    # driven by:          peer      opcua     page      ros2      shield    scenario  foxglove  teleop
    "taken by peer":     ("-",      "taken",  "refused","taken",  "taken",  "refused","refused","taken"),
    "taken by opcua":    ("taken",  "-",      "refused","taken",  "taken",  "refused","refused","taken"),
    "taken by page":     ("taken",  "taken",  "-",      "taken",  "taken",  "refused","taken",  "taken"),
    "taken by ros2":     ("taken",  "taken",  "refused","-",      "taken",  "refused","refused","taken"),
    "taken by shield":   ("taken",  "taken",  "refused","taken",  "-",      "refused","refused","taken"),
    "taken by scenario": ("taken",  "taken",  "taken",  "taken",  "taken",  "-",      "taken",  "taken"),
    "taken by foxglove": ("taken",  "taken",  "taken",  "taken",  "taken",  "refused","-",      "taken"),
    "taken by teleop":   ("taken",  "taken",  "refused","taken",  "taken",  "refused","refused","-"),
    "given back":        ("-",      "before", "before", "before", "before", "before", "before", "before"),
    "closed":            ("safe",   "nobody", "nobody", "off",    "off",    "drives", "zero",   "nobody"),
    "cut":               ("drives", "nobody", "nobody", "-",      "off",    "-",      "zero",   "-"),
    "killed":            ("safe",   "nobody", "nobody", "off",    "off",    "-",      "zero",   "nobody"),
    "silent":            ("safe",   "drives", "zero",   "off",    "off",    "-",      "zero",   "zero"),
    "stopped":           ("safe",   "safe",   "safe",   "safe",   "safe",   "safe",   "safe",   "safe"),
    "lock held":         ("safe",   "safe",   "safe",   "safe",   "safe",   "safe",   "safe",   "safe"),
    "paused":            ("anew",   "anew",   "anew",   "anew",   "anew",   "-",      "anew",   "anew"),
    "stepped":           ("anew",   "anew",   "anew",   "anew",   "anew",   "-",      "anew",   "anew"),
    "slowed":            ("safe",   "drives", "zero",   "off",    "off",    "drives", "zero",   "zero"),
    "reset":             ("anew",   "anew",   "anew",   "anew",   "anew",   "-",      "anew",   "anew"),
    "snapshot":          ("anew",   "anew",   "anew",   "anew",   "anew",   "-",      "anew",   "anew"),
    "overrun":           ("safe",   "drives", "zero",   "off",    "off",    "drives", "zero",   "zero"),
    "forced":            ("forced", "forced", "forced", "forced", "forced", "forced", "forced", "forced"),
    "acknowledged":      ("anew",   "anew",   "anew",   "anew",   "anew",   "nobody", "anew",   "anew"),
    "held over":         ("start",  "start",  "rest",   "start",  "start",  "nobody", "rest",   "rest"),
    "restarted":         ("before", "before", "before", "before", "before", "before", "before", "before"),
    "closed, fallback before": ("-", "before", "before", "-",   "-",      "-",      "-",      "before"),
    "cut, fallback before":    ("-", "before", "before", "-",   "-",      "-",      "-",      "-"),
    "killed, fallback before": ("-", "before", "before", "-",   "-",      "-",      "-",      "before"),
    "silent, fallback before": ("-", "drives", "zero",   "-",   "-",      "-",      "-",      "zero"),
    "overrun, stretch":  ("safe",   "drives", "zero",   "off",    "off",    "drives", "zero",   "zero"),
}
# fmt: on


def parts(event: str) -> tuple[str, str]:
    """Return what happens, and the variant of the configuration in which it does."""
    what, _, variant = event.partition(", ")
    return what, variant


def cells() -> Iterator[tuple[str, str, str]]:
    """Yield event, source and expected outcome of every cell that exists."""
    for event, row in TABLE.items():
        for source, outcome in zip(SOURCES, row, strict=True):
            if outcome != "-":
                yield event, source, outcome


_HEAD = """# The control matrix

Made from the table of `tests/control` by `python -m tests.control.table`; a test keeps it up to date.
It is what has to happen. `make test` runs one cell of every event, `python -m pytest -m "long or not long"
tests/control` all of them.

Which outcome follows, by who drives at first (columns) and what happens then (rows). All sources are
connected, and peer, ROS 2 host and shield host go on offering commands while another source drives.
Configuration: `control.source: peer`, priorities as shipped, no limit for silent OPC UA clients,
`control.fallback: nobody` unless a row says `fallback before`, overruns are skipped unless it says
`stretch`. What the wheels get and who drives is read in shared memory by another process.

"""


def as_markdown() -> str:
    """Return the page."""
    head = f"| what happens | {' | '.join(SOURCES)} |\n|{'---|' * (len(SOURCES) + 1)}\n"
    rows = "".join(f"| {event} | {' | '.join(row)} |\n" for event, row in TABLE.items())
    events = "".join(f"| {event} | {what} |\n" for event, what in EVENTS.items())
    outcomes = "".join(f"| {name} | {what} |\n" for name, what in OUTCOMES.items())
    return (
        f"{_HEAD}{head}{rows}\n| what happens | means |\n|---|---|\n{events}"
        f"\n| outcome | means |\n|---|---|\n{outcomes}"
    )


if __name__ == "__main__":
    print(as_markdown(), end="")
