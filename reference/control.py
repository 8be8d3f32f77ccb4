"""The page of who drives."""

from collections.abc import Mapping
from typing import Final

from hilserver.core.handover import TABLE, Happening, Standing

MEANING: Final[Mapping[Happening, str]] = {
    Happening.TAKE: "writes its own kind to `control.source`: what drives is ramped to zero, then"
    " its own commands count; another client of its kind begins at zero, too",
    Happening.GIVE: "writes another kind to `control.source`: the newest command that peer, ROS 2"
    " or shield offer is ramped to",
    Happening.RELEASE: "writes `nobody` to `control.source`",
    Happening.COMMAND: "writes set-points, mode or enable; what peer, ROS 2 and shield write"
    " without control is kept as their offer",
    Happening.GONE: "the client that took control has no session or connection any more;"
    " set-points that an OPC UA client wrote last, without taking it, become zero",
    Happening.LAPSE: "has not renewed its command in time: its policy acts in the plant's tick",
    Happening.STOP: "safe state: a ramp to zero, then the drive is disabled",
    Happening.RESET: "every lease ends: zero until a command comes in anew; after a safe state"
    " that of an automatic source counts only after Start",
    Happening.PAUSE: "every lease ends: Start and Step go on at zero",
    Happening.LOAD: "every lease ends: the state comes back, the commands of then do not",
}

LIMITS: Final = (
    (
        "peer",
        "`peers[].stale_after_ms`",
        "`peers[].on_stale`: hold, zero or ramp (safe state)",
    ),
    ("opcua", "`control.opcua_stale_after_ms`, by default for ever", "safe state"),
    ("opcua, `hilserver teleop`", "`page.deadman_ms`", "set-points zero"),
    ("page, Foxglove", "`page.deadman_ms`", "set-points zero"),
    (
        "ros2",
        "`ros2.stale_after_ms`",
        "`ros2.on_stale`: device (drive disabled), ramp, zero, or hold while its writer is alive",
    ),
    (
        "shield",
        "`shield.stale_after_ms`, or as its host says",
        "`shield.on_stale`: the same",
    ),
    ("scenario", "for ever: its steps are planned", ""),
    (
        "whoever drives",
        "`control.command_timeout_ms`, by default for ever",
        "set-points zero",
    ),
)
"""Source, how long its command holds, what then happens."""

_HEAD = """# Who drives

Made from the code by `make reference`; a test keeps it up to date.

One kind of source has control: it is written to and read from `control.source`, and `nobody` is a
possible answer. Every command is a lease: it has to be renewed, or it lapses, in the plant's own
tick, whatever has become of the event loop. A handover never jumps: the set-points of before are
ramped to zero within `plant.safe_ramp_s`, then those of the new source are ramped to.

Who has control after an event, by how the source that causes it stands to the one that has it
("-": refused, with a sentence that says who has control):

"""
_MIDDLE = """
`control.fallback` is nobody, or the source before; after a Stop, a lapse or the safe state nobody
drives by himself.

| source | its command holds for | then |
|---|---|---|
"""


def as_markdown() -> str:
    """Return the reference page."""
    standings = tuple(Standing)
    head = f"| event | {' | '.join(standings)} | meaning |\n|{'---|' * (len(standings) + 2)}\n"
    rows = [
        f"| {event} | {' | '.join(following)} | {MEANING[event]} |\n"
        for event, following in TABLE.items()
    ]
    limits = "".join(f"| {' | '.join(row)} |\n" for row in LIMITS)
    return _HEAD + head + "".join(rows) + _MIDDLE + limits
