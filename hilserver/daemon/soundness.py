"""What a configuration asks for and can never have, and what it hardly means as it stands.

Each section is checked when it is read, and the robot when it is assembled; this looks across
sections, and at this computer. `hilserver check` and `hilserver run` both ask here, so one refuses
what the other does, with the same sentence.
"""

import os
import sys
from collections import defaultdict
from collections.abc import Iterator
from fnmatch import fnmatchcase
from itertools import combinations
from typing import Final, NamedTuple
from urllib.parse import urlsplit

from hilserver.config.loading import MAX_COMPLAINTS, place
from hilserver.config.plant import check_apart
from hilserver.daemon.assembled import Assembly
from hilserver.errors import ConfigError, meant
from hilserver.io.edge.payload import collections_of
from hilserver.io.opcua_server.method_table import METHODS
from hilserver.io.opcua_server.model import CONTROL_SOURCE, PARAMETERS
from hilserver.io.opcua_server.model import describe as address_space
from hilserver.io.s7.blocks import blocks_of
from hilserver.opcua.loopback import is_loopback
from hilserver.plant.errors import PlantError
from hilserver.plant.layout import WHEELS

_EVERYWHERE: Final = ("0.0.0.0", "::", "")  # noqa: S104 - compared, not listened on
_SIGNALS: Final = "see 'hilserver signals' for the names"
_ONE_TURNS: Final = frozenset(f"wheel.{wheel}.setpoint_rpm" for wheel in WHEELS)


class Complaint(NamedTuple):
    """Something that can never work, or is probably not meant."""

    location: tuple[str | int, ...]  # keys of the configuration
    sentence: str


# --- names and patterns ---------------------------------------------------------------


def unknown_names(assembly: Assembly) -> Iterator[Complaint]:
    """Yield patterns that match nothing, and slices that do not exist."""
    config = assembly.config
    table = assembly.table
    scalars = [signal.name for signal in table.scalars]
    for index, pattern in enumerate(config.recording.signals):
        if why := _matches_none(pattern, scalars):
            place_in_list = ("recording", "signals", index)
            yield Complaint(place_in_list, f"no signal matches {why}")

    compiled = [one.name for one in assembly.slices if one.compiled]
    for name in ("mechatronic", "observer"):
        wanted = getattr(config, name).slice
        known = [name, *compiled]
        if wanted not in known:  # unless it is on, it was not looked for yet
            listed = ", ".join(known)
            text = f"there is no plant-side slice '{wanted}'; slices are {listed}"
            yield Complaint((name, "slice"), text)

    if not config.opcua.enabled:
        return
    inputs = [s.name for s in table if s.writable and not s.hidden]
    inputs.append(CONTROL_SOURCE)
    inputs += [PARAMETERS + name for name in assembly.composition.settings]
    permissions = config.opcua.permissions
    for pattern in permissions.write:
        if why := _matches_none(pattern, inputs):
            at = ("opcua", "permissions", "write", pattern)
            text = f"restricts nothing: no input or parameter matches {why}"
            yield Complaint(at, text)

    methods = [method.name for method in METHODS]
    listed = ", ".join(methods)
    for pattern in permissions.call:
        if why := _matches_none(pattern, methods, f"methods are {listed}"):
            at = ("opcua", "permissions", "call", pattern)
            text = f"restricts nothing: no method matches {why}"
            yield Complaint(at, text)


def _matches_none(pattern: str, names: list[str], otherwise: str = _SIGNALS) -> str:
    """Return the pattern with a remedy, or nothing if one of the names matches it."""
    if any(fnmatchcase(name, pattern) for name in names):
        return ""
    return f"'{pattern}'; {meant(pattern, names, otherwise)}"


# --- addresses ------------------------------------------------------------------------


def shared_addresses(assembly: Assembly) -> Iterator[Complaint]:
    """Yield ports that two servers of the daemon would listen on."""
    config = assembly.config
    opcua = config.opcua
    s7 = config.s7.server
    listening: dict[tuple[str, ...], tuple[str, int]] = {}
    if opcua.enabled:
        listening["opcua", "endpoint"] = opcua.host, opcua.port
    for name in ("metrics", "page", "foxglove"):
        section = getattr(config, name)
        if section.enabled:
            listening[name, "port"] = section.host, section.port
    if s7 is not None:
        listening["s7", "server", "port"] = s7.host, s7.port
    for (one, first), (two, second) in combinations(listening.items(), 2):
        if first[1] == 0 or first[1] != second[1]:
            continue
        if not _same_place(first[0], second[0]):
            continue
        # The mistake is where a port was changed, not where it is the usual one.
        given = getattr(config, two[0]).model_fields_set
        is_usual = two[-1] not in given and two[0] != "s7"
        at, other = (one, two) if is_usual else (two, one)
        key = ".".join(other)
        text = f"port {first[1]} is already that of {key}; choose another one, or 0 for any"
        yield Complaint(at, text)

    own_port = opcua.port if opcua.enabled else 0
    for index, peer in enumerate(config.peers):
        if own_port == 0 or peer.is_s7 or not peer.is_local:
            continue
        port = urlsplit(peer.endpoint).port
        if port == own_port:
            text = f"{peer.endpoint} is this daemon's own server (opcua.endpoint)"
            yield Complaint(("peers", index, "endpoint"), text)


def _same_place(one: str, other: str) -> bool:
    if one in _EVERYWHERE or other in _EVERYWHERE:
        return True
    return one == other or (is_loopback(one) and is_loopback(other))


# --- the drive ------------------------------------------------------------------------


def dead_drive(assembly: Assembly) -> Iterator[Complaint]:
    """Yield why no wheel could ever turn."""
    gains = assembly.config.plant.controller
    if gains.k_p == gains.k_i == 0.0:
        text = "k_p and k_i are both 0, so no set-point ever moves a wheel; set at least one"
        yield Complaint(("plant", "controller", "k_i"), text)


def overlapping_wheels(assembly: Assembly) -> Iterator[Complaint]:
    """Yield axles that are closer than their wheels allow, as where the default was left."""
    try:
        check_apart(assembly.robot)
    except PlantError as error:
        _, _, rest = str(error).partition(": ")
        yield Complaint(("plant", "wheelbase_m"), rest)


def slow_drive(assembly: Assembly) -> Iterator[Complaint]:
    """Yield set-points that the wheels do not reach."""
    plant = assembly.config.plant
    limit_pct = plant.controller.limit_pct
    reachable_rpm = plant.process.gain * limit_pct
    by_torque = assembly.config.mechatronic.turns_wheels
    if plant.max_rpm > reachable_rpm and not by_torque:
        text = (
            f"{plant.max_rpm:g} rpm are never reached: {limit_pct:g} % duty turn"
            f" the wheels at {reachable_rpm:.4g} rpm (plant.process.gain)"
        )
        yield Complaint(("plant", "max_rpm"), text)
    if plant.controller.k_i == 0.0:
        text = "0 leaves the wheels below their set-points, as k_p alone does"
        yield Complaint(("plant", "controller", "k_i"), text)


# --- files --------------------------------------------------------------------------


def unwritable_names(assembly: Assembly) -> Iterator[Complaint]:
    """Yield paths with letters that the names of this computer's files cannot have."""
    config = assembly.config
    named = {("recording", "file"): config.recording.file}
    named["snapshots", "folder"] = config.snapshots.folder
    for name, folder in config.folders:
        named["folders", name] = str(folder)
    encoding = sys.getfilesystemencoding()
    for at, path in named.items():
        try:
            str(path).encode(encoding, "surrogateescape")
        except UnicodeEncodeError as error:
            letter = error.object[error.start]
            text = (
                f"file names are {encoding} here and cannot have '{letter}': set LANG=C.UTF-8, or"
                " choose another name"
            )
            yield Complaint(at, text)


# --- time -----------------------------------------------------------------------------


def impossible_time(assembly: Assembly) -> Iterator[Complaint]:
    """Yield time limits that are over at once, and a core that is not there."""
    config = assembly.config
    base_ms = assembly.base_period_ns * 1e-6
    ticks = {one.name: one.period_ticks for one in assembly.slices}
    ticks_of_plant = ticks[config.plant.slice]
    plant_ms = ticks_of_plant * base_ms
    for key in ("command_timeout_ms", "opcua_stale_after_ms"):
        limit_ms = getattr(config.control, key)
        if limit_ms is not None and limit_ms <= plant_ms:
            text = (
                f"{limit_ms:g} ms are over before the next command can act, every {plant_ms:g} ms"
                " (plant.slice): write several times as much, or null"
            )
            yield Complaint(("control", key), text)

    scheduler = config.scheduler
    cpu = scheduler.realtime.cpu
    cores = os.cpu_count() or 1
    if scheduler.backend != "thread" or cpu is None:
        return
    if cpu >= cores:
        text = f"this computer has no core {cpu}; its cores are 0 to {cores - 1}"
        yield Complaint(("scheduler", "realtime", "cpu"), text)


# --- who commands ---------------------------------------------------------------------


def mute_sources(assembly: Assembly) -> Iterator[Complaint]:
    """Yield a source that has control at the start and can never command."""
    config = assembly.config
    if config.opcua.enabled:
        return
    if config.control.source == "opcua":
        text = "'opcua' can never command: opcua.enabled is false"
        yield Complaint(("control", "source"), text)
    if config.control.source == "page" and not config.foxglove.enabled:
        text = "'page' can never command: the page writes by OPC UA, and opcua.enabled is false"
        yield Complaint(("control", "source"), text)


def doubtful_peers(assembly: Assembly) -> Iterator[Complaint]:
    """Yield peers that command what nobody means, or too rarely."""
    config = assembly.config
    endpoints = defaultdict[str, list[str]](list)
    for index, peer in enumerate(config.peers):
        for node in peer.read:
            if set(peer.inputs_of(node)) >= _ONE_TURNS:
                text = (
                    f"'{node}' sets all four wheels, so the robot only turns on the spot: the right"
                    " wheels are mirrored, and go ahead with the opposite sign"
                )
                yield Complaint(("peers", index, "read"), text)
        if others := endpoints[peer.endpoint]:
            text = f"{peer.endpoint} is also the endpoint of peer '{others[0]}'"
            yield Complaint(("peers", index, "endpoint"), text)
        others.append(peer.name)

        polls = peer.is_s7 or peer.mode == "poll"
        interval_ms = peer.poll_ms if polls else peer.publishing_ms
        limit_ms = config.control.command_timeout_ms
        if limit_ms is not None and peer.read and interval_ms >= limit_ms:
            key = "poll_ms" if polls else "publishing_ms"
            text = (
                f"values come every {interval_ms:g} ms, and control.command_timeout_ms is"
                f" {limit_ms:g}"
            )
            yield Complaint(("peers", index, key), text)


# --- keys without effect --------------------------------------------------------------


def idle_keys(assembly: Assembly) -> Iterator[Complaint]:
    """Yield what has no effect beside the rest of the configuration."""
    config = assembly.config
    used = {part.slice for part in assembly.composition.parts}
    own = {block.slice for block in config.blocks}
    used |= own
    for one in assembly.slices:
        if one.compiled and one.name not in used:
            text = "nothing runs in this slice"
            yield Complaint(("scheduler", "slices", one.name), text)
    recording = config.recording
    if recording.keep is not None and recording.rotate_mb is None:
        text = "has no effect without recording.rotate_mb"
        yield Complaint(("recording", "keep"), text)

    observer = config.observer
    is_simulated = observer.enabled and observer.source == "simulated"
    if is_simulated and not config.sensors.nav.enabled:
        text = "sensors.nav is off, so the estimate drifts away with the wheels"
        yield Complaint(("observer", "source"), text)


# --- all of them ----------------------------------------------------------------------

IMPOSSIBLE: Final = (
    unknown_names,
    shared_addresses,
    dead_drive,
    unwritable_names,
    impossible_time,
    mute_sources,
)
DOUBTFUL: Final = (overlapping_wheels, slow_drive, doubtful_peers, idle_keys)


def check_sound(assembly: Assembly) -> None:
    """Refuse what can never work.

    ConfigError has one sentence per complaint, with file, line and key.
    """
    config, table = assembly.config, assembly.table
    with assembly.at("blocks"):  # a name or unit may be one that OPC UA cannot show
        address_space(table)
    if config.edge.enabled:
        with assembly.at("edge", "groups"):
            collections_of(config.edge, table)
    if config.s7.server is not None:
        with assembly.at("s7", "server", "blocks"):
            blocks_of(config.s7.server, table)

    found = [complaint for look in IMPOSSIBLE for complaint in look(assembly)]
    if found:
        lines = [place(assembly.path, at) + text for at, text in found]
        raise ConfigError("\n".join(lines[:MAX_COMPLAINTS]))


def doubts(assembly: Assembly) -> list[str]:
    """Return what is allowed but probably not meant, a sentence each."""
    found = (complaint for look in DOUBTFUL for complaint in look(assembly))
    return [place(None, at) + text for at, text in found]
