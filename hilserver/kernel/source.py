"""Writes the step of one configuration: a list of calls, because numba cannot loop over functions.

The called functions are in `phases`, `parts`, `fitted` and the blocks; here is only their order.
"""

from collections.abc import Iterable, Sequence

from hilserver.image.layout import Layout, Region
from hilserver.kernel.composition import BlockUse, Composition, ObserverUse, RobotPart
from hilserver.kernel.observer_parts import find_observer
from hilserver.kernel.places import find_body, find_places

BODY = "body"
"""The part that can fail: the mechatronic model's own slice, after the robot's other parts."""

OBSERVER = "observer"  # this part runs last in its slice

_BODY_CALL = "body_parts.body(AT, BODY, values, words)"
_HEAD = '''\
"""Generated: which parts run in which slice, and where in the process image their numbers lie."""

import numpy as np

from hilserver.compiled import kernel
from hilserver.kernel import {rooms}
from hilserver.kernel.places import {places}
from hilserver.scheduler.step import FAULT, LATCH, PUBLISH, STEP_SIGNATURE

'''

_PHASES = """

@kernel(STEP_SIGNATURE)
def step(phase, tick, planned_ns, values, words):
    if phase == LATCH:
        request = phases.requested(words)
{before}        tick = phases.latch(request, tick, planned_ns, AT, values, words)
{after}        return tick
    if phase == PUBLISH:
        fitted.flag_unfitted({limits}, values, words)
        return phases.publish(tick, planned_ns, AT, values, words)
    if phase == FAULT:
        return phases.enter_safe(tick, AT, values, words)
"""


def step_source(composition: Composition, layout: Layout) -> str:
    """Return the source of the step, a module with the function ``step``."""
    blocks = list(enumerate(composition.blocks))
    places = find_places(layout, composition.table)._asdict()
    lines = [
        "AT = Places(",
        *(f"    {name}={place}," for name, place in places.items()),
        ")",
    ]
    if composition.body is not None:
        numbers = find_body(layout, composition.table)._asdict().items()
        lines += [
            "BODY = BodyPlaces(",
            *(f"    {name}={place}," for name, place in numbers),
            ")",
        ]
    observer = composition.observer
    if observer is not None:
        found = find_observer(
            layout, composition.table, observer.nav_ticks, observer.imu_ticks
        )
        lines += ["OBSERVER = observer_parts.ObserverPlaces("]
        lines += [
            *(f"    {name}={place}," for name, place in found._asdict().items()),
            ")",
        ]
    for number, block in blocks:
        lines += _block_slots(number, block, composition)
    body: list[str] = []
    for index, name in enumerate(composition.slices):
        period_s = composition.periods_s[name]
        in_slice = [(number, block) for number, block in blocks if block.slice == name]
        body.append(f"if phase == {index}:  # slice '{name}', every {period_s:g} s")
        own = [part for part in composition.parts if part.slice == name]
        body += [
            f"    {_part_call(part, observer)}" for part in own if part.name != BODY
        ]
        has_body = any(part.name == BODY for part in own)
        if has_body or in_slice:
            body.append(f"    fault = {_BODY_CALL if has_body else 0}")
        for number, block in in_slice:
            body += [
                f"    {line}" for line in _block_call(number, block, period_s, layout)
            ]
        body.append(f"    return {'fault' if has_body or in_slice else '0'}")
    body.append("return 0")
    rooms, names = "fitted, parts, phases", "Places"
    if composition.body is not None:
        rooms, names = f"body_parts, {rooms}", f"BodyPlaces, {names}"
    if observer is not None:
        rooms = f"{rooms}, observer_parts"
    phases = _PHASES.format(
        limits=layout.regions["fitted"].base,
        before=_around_latch(blocks, layout, "keep", "phases.SAVES"),
        after=_around_latch(blocks, layout, "adopt", "phases.RESTORES"),
    )
    head = _HEAD.format(rooms=rooms, places=names)
    return head + _text(lines) + phases + _text(f"    {line}" for line in body)


def _part_call(part: RobotPart, observer: ObserverUse | None) -> str:
    if part.name == OBSERVER and observer is not None:
        return f"observer_parts.{observer.source}(AT, OBSERVER, tick, values, words)"
    if part.of_body:
        return f"body_parts.{part.name}(AT, BODY, values, words)"
    return f"parts.{part.name}(AT, values, words)"


def _text(lines: Iterable[str]) -> str:
    return "".join(f"{line}\n" for line in lines)


def _block_slots(number: int, block: BlockUse, composition: Composition) -> list[str]:
    inputs = [block.inputs[name] for name in block.declaration.inputs]
    outputs = [block.output_signal(output.name) for output in block.declaration.outputs]
    lines = [
        f"INPUTS_{number} = {_slots(inputs, composition)}",
        f"OUTPUTS_{number} = {_slots(outputs, composition)}",
    ]
    return lines + _commands(number, block, composition) if block.drives else lines


def _commands(number: int, block: BlockUse, composition: Composition) -> list[str]:
    """Return lines with the slots that outputs command, and the range of each command."""
    names = [output.name for output in block.declaration.outputs]
    signals = [composition.table[name] for name in block.drives.values()]
    numbers = [names.index(output) for output in block.drives]
    return [
        f"COMMANDS_{number} = {_slots(list(block.drives.values()), composition)}",
        f"FROM_{number} = np.array({numbers}, dtype=np.int64)",
        f"RANGES_{number} = np.array({[[float(s.low), float(s.high)] for s in signals]})",
    ]


def _slots(signals: Sequence[str], composition: Composition) -> str:
    slots = [composition.table.slot(name) for name in signals]
    return f"np.array({slots}, dtype=np.int64)  # {', '.join(signals)}"


def _around_latch(
    blocks: Sequence[tuple[int, BlockUse]], layout: Layout, verb: str, task: str
) -> str:
    """Return calls, around the latch, of models whose state is outside the image."""
    calls = [
        f"{verb}_{number}({_arrays(block, layout)})"
        for number, block in blocks
        if block.foreign is not None
    ]
    if not calls:
        return ""
    head = ["task = phases.task(request, words)"] if verb == "keep" else []
    lines = [*head, f"if task == {task}:", *(f"    {line}" for line in calls)]
    return _text(f"        {line}" for line in lines)


def _arrays(block: BlockUse, layout: Layout) -> str:
    """Return u, y, x and p of a foreign block, and its addresses."""
    pieces = [_piece(layout.regions[f"{block.name}.{array}"]) for array in "uyxp"]
    a = layout.regions[f"{block.name}.a"]
    return ", ".join([*pieces, f"words[{a.base} : {a.base + a.length}]"])


def _piece(region: Region) -> str:
    return f"values[{region.base} : {region.base + region.length}]"


def _replayed(number: int, block: BlockUse, layout: Layout) -> list[str]:
    """Return the line that reads replayed outputs from the frame, where a replay has put them."""
    n = sum(output.is_replayed for output in block.declaration.outputs)
    y = layout.regions[f"{block.name}.y"]
    last = f"values[{y.base + y.length - n} : {y.base + y.length}]"
    return (
        [f"parts.read_inputs(OUTPUTS_{number}[-{n}:], {last}, values, words)"]
        if n
        else []
    )


def _block_call(
    number: int, block: BlockUse, period_s: float, layout: Layout
) -> list[str]:
    drive = f"parts.drive(COMMANDS_{number}, FROM_{number}, RANGES_{number}, {{y}}, values, words)"
    u, y, x, p = (_piece(layout.regions[f"{block.name}.{array}"]) for array in "uyxp")
    if block.foreign is not None:
        return [
            f"# {block.name}",
            f"parts.read_inputs(INPUTS_{number}, {u}, values, words)",
            *_replayed(number, block, layout),
            f"if step_{number}(tick, {period_s!r}, {_arrays(block, layout)}) != 0:",
            f"    fault = {number + 1}",
            f"parts.write_outputs(OUTPUTS_{number}, {y}, values, words)",
        ]
    return [
        f"# {block.name}",
        f"parts.read_inputs(INPUTS_{number}, {u}, values, words)",
        "try:",
        f"    block_{number}(",
        f"        {period_s!r},  # dt_s",
        f"        {u},  # u",
        f"        {y},  # y",
        f"        {x},  # x",
        f"        {p},  # p",
        "    )",
        "except Exception:",
        f"    fault = {number + 1}",
        f"    parts.give_up({y})",
        f"parts.write_outputs(OUTPUTS_{number}, {y}, values, words)",
        *([drive.format(y=y)] if block.drives else []),
    ]
