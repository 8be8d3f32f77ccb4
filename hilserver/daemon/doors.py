"""Every way into the robot, and who may do what by it: one table, for `check` and the start."""

from collections.abc import Iterator
from typing import Final, NamedTuple

from hilserver.config.doors import Right
from hilserver.config.root import Config
from hilserver.opcua.settings import Role, needed_role
from hilserver.signals import MEASURED

EVERYONE, SECTION, NOBODY = "everyone", "its section", "-"
_EXAMPLES: Final = (
    "measured.nav.x_m",
    "twist.linear_m_s",
    "plant.max_rpm",
    "LoadSnapshot",
)
"""Of each right what the table of permissions is asked for."""


class DoorRow(NamedTuple):
    """A door, and who may what."""

    title: str
    measured: str = NOBODY
    command: str = NOBODY
    parameters: str = NOBODY
    administer: str = NOBODY


def rows_of(config: Config) -> Iterator[DoorRow]:
    """Yield the doors that are open, in the order of how well they know who comes."""
    # Who may use each right where people log in.
    permissions = config.opcua.permissions
    *written, called = _EXAMPLES
    needed = [needed_role(permissions.write, name) for name in written]
    if needed[-1] is not None:
        # of parameters, whatever the table says
        needed[-1] = max(needed[-1], Role.ENGINEER)
    needed.append(needed_role(permissions.call, called))
    people = [_who(config, role) for role in needed]
    if config.opcua.enabled:
        yield DoorRow("OPC UA", *people)
        yield DoorRow("shell", *people)
    if config.page.enabled:
        yield DoorRow("page", *(people if config.opcua.enabled else ()))
    for door in config.doors:
        if door.is_open:
            may = [EVERYONE if right in door.rights else NOBODY for right in Right]
            yield DoorRow(door.title, *may)
    if config.shield.enabled:
        yield DoorRow("shield", command=SECTION)
    for peer in config.peers:
        is_measured = [name.startswith(MEASURED) for name in peer.inputs]
        may = [SECTION if any(is_measured) else NOBODY]
        may += [SECTION if not all(is_measured) else NOBODY]
        yield DoorRow(f"peer {peer.name}", *may)
    if config.opcua.enabled:
        starts = _who(
            config, needed_role(config.opcua.permissions.call, "StartScenario")
        )
        yield DoorRow("scenario", starts, starts, starts)


def _who(config: Config, needed: Role | None) -> str:
    if needed is None:
        return NOBODY
    stranger = config.opcua.anonymous_role
    if stranger is not None and stranger >= needed:
        return EVERYONE
    return needed.name.lower()


def table_of_doors(config: Config) -> list[str]:
    """Return the table, a line per door."""
    table = [("door", *(str(right) for right in Right)), *rows_of(config)]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    padded = (
        "  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True))
        for row in table
    )
    return [f"  {line}".rstrip() for line in padded]


def doors_lost(config: Config) -> list[str]:
    """Return a sentence for each open door that may do less because users are named."""
    words = {Right.MEASURED: "write measured.*", Right.PARAMETERS: "set parameters"}
    sentences = []
    for door in config.doors:
        if door.is_open and door.lost:
            acts = " or ".join(words.get(right, str(right)) for right in door.lost)
            sentences.append(
                f"{door.title} has no log-in, so it may not {acts}: opcua.users and"
                f" opcua.anonymous say who may; '{door.way_out}' grants it to everyone there"
            )
    return sentences
