"""Where the parts of a configuration are in the process image, in which alone steps differ."""

from typing import Any, NamedTuple

from hilserver.compiled import inlined
from hilserver.compiled.records import record_at
from hilserver.image.layout import Layout
from hilserver.plant.layout import INPUTS, OUTPUTS, PARAMETERS, STATE, STATUS, Inputs
from hilserver.signals import SignalTable


class Places(NamedTuple):
    """Where the robot's numbers begin, and the slots that the phases need."""

    # index into `values`: parameters, state, inputs, outputs, walls, counter of the parameters
    p: int
    x: int
    u: int
    y: int
    q: int  # index into `words`: status codes of the outputs
    hall: int
    hall_end: int  # index into `values` behind the last wall
    edition: int
    # slots of the signals ``internal.command``, ``drive.enable``, ``internal.state`` and
    # ``sim.tick``; ``sim.time_s``, ``sim.state``, ``internal.state`` and ``internal.edition``
    # follow the last
    command: int
    enable: int
    state: int
    sim: int


def find_places(layout: Layout, table: SignalTable) -> Places:
    """Return the places of a layout: the frame begins with the inputs, the outputs follow."""
    regions = layout.regions
    frame, status, hall = regions["frame"].base, regions["status"].base, regions["hall"]
    return Places(
        p=regions["p"].base,
        x=regions["x"].base,
        u=frame,
        y=frame + Inputs.n_words,
        q=status + Inputs.n_words,
        hall=hall.base,
        hall_end=hall.base + hall.length,
        edition=regions["edition"].base,
        command=table.slot("internal.command"),
        enable=table.slot("drive.enable"),
        state=table.slot("internal.state"),
        sim=table.slot("sim.tick"),
    )


@inlined
def p(at: Places, values: Any) -> Any:
    """Return the robot's parameters."""
    return record_at(values, at.p, PARAMETERS)


@inlined
def x(at: Places, values: Any) -> Any:
    """Return its state."""
    return record_at(values, at.x, STATE)


@inlined
def u(at: Places, values: Any) -> Any:
    """Return its inputs of this tick, in the working frame."""
    return record_at(values, at.u, INPUTS)


@inlined
def y(at: Places, values: Any) -> Any:
    """Return its outputs, in the working frame."""
    return record_at(values, at.y, OUTPUTS)


@inlined
def q(at: Places, words: Any) -> Any:
    """Return the status codes of its outputs."""
    return record_at(words, at.q, STATUS)


class BodyPlaces(NamedTuple):
    """Where the numbers of the mechatronic model begin."""

    # index into `values`: parameters, state, behind the state
    p: int
    b: int
    b_end: int
    a: int  # index into `words`: addresses
    # index into `values` and `words`: its outputs and their status codes
    out: int
    status: int


def find_body(layout: Layout, table: SignalTable) -> BodyPlaces:
    """Return the places of a layout that has a mechatronic model."""
    regions, first = layout.regions, table.slot("mech.x_m")
    state = regions["body"]
    return BodyPlaces(
        p=regions["body_p"].base,
        b=state.base,
        b_end=state.base + state.length,
        a=regions["body_a"].base,
        out=regions["frame"].base + first,
        status=regions["status"].base + first,
    )
