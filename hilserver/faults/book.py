"""Injects, ends, forces and lists: one book for scenarios, OPC UA and tests."""

import itertools
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hilserver.core.events import Event, EventBus, EventKind
from hilserver.errors import ControlRefused
from hilserver.faults.links import PeerLine
from hilserver.faults.mail import Mailbox, ModifierCommand
from hilserver.faults.model import Fault, parse_fault
from hilserver.faults.plan import Planner
from hilserver.kernel import modifier_layout as lay
from hilserver.kernel.modifier_layout import Kind, ModifierEntry
from hilserver.signals import SignalTable

Figure = float | str | bool | int | None
FORCE = "force"
_RESET_ROWS = 2


@dataclass(frozen=True, slots=True)
class ActiveFault:
    """One fault or force that waits or acts."""

    name: str
    fault: str
    place: str
    # None: not yet taken, or without end
    from_tick: int | None
    until_tick: int | None
    is_acting: bool  # False while it waits for its time


@dataclass(frozen=True, slots=True)
class _Note:
    fault: Fault
    entries: int
    rings: int
    mail: int


def _note(fault: Fault, entries: Sequence[ModifierEntry], mail: int = 0) -> _Note:
    rings = sum(entry.kind in lay.RING_KINDS for entry in entries)
    return _Note(fault, len(entries), rings, mail)


def _expect_places(notes: Collection[_Note], remedy: str) -> None:
    if sum(note.entries for note in notes) > lay.MAX_MODIFIERS:
        raise ValueError(
            f"more than {lay.MAX_MODIFIERS} signals cannot be modified at once; {remedy}"
        )
    if sum(note.rings for note in notes) > lay.MAX_RINGS:
        raise ValueError(
            f"more than {lay.MAX_RINGS} signals cannot be delayed at once; {remedy}"
        )


class Faults:
    """Injects faults and forces signals; everything takes effect at the start of a tick."""

    def __init__(
        self,
        table: SignalTable,
        mailbox: Mailbox,
        planner: Planner,
        events: EventBus,
        *,
        tick: Callable[[], int],
        lines: Mapping[str, PeerLine],
    ) -> None:
        self._table = table
        self._mailbox = mailbox
        self._planner = planner
        self._events = events
        self._tick = tick
        self._lines = lines
        self._notes: dict[int, _Note] = {}
        # number: it is gone once this many commands are taken
        self._leaving: dict[int, int] = {}
        # called with every command, in plain data: {"inject": [...], "start_tick"} or {"clear"}
        self.watchers: list[Callable[[Mapping[str, Any]], None]] = []
        # A restored state brings modifiers of earlier runs along: none may have the same number.
        self._numbers = itertools.count(time.time_ns())

    # --- commands ---------------------------------------------------------------------------------

    def inject(self, *faults: object, start_tick: int | None = None) -> list[str]:
        """Inject faults, all in the same tick; return their names.

        `start_tick`: tick from which their times count; None: the next one. ValueError, one
        sentence, means that none of them was injected.
        """
        parsed = [parse_fault(fault) for fault in faults]
        commands: list[ModifierCommand] = []
        notes: dict[int, _Note] = {}
        for fault in parsed:
            if fault.peer is not None:
                self._line(fault.peer)
                continue
            entries = self._planner.entries(fault, self._start(fault, start_tick))
            number = next(self._numbers)
            commands += self._removals(fault.title)
            commands += [
                ModifierCommand(lay.OP_ADD, number, entry) for entry in entries
            ]
            notes[number] = _note(fault, entries, self._mailbox.head + len(commands))
        self._send(commands, notes)
        given = [f.model_dump(exclude_none=True, exclude_defaults=True) for f in parsed]
        self._watched({"inject": given, "start_tick": start_tick})
        for fault in parsed:
            if fault.peer is not None:
                self._line(fault.peer).inject(fault)
            self._tell(f"fault injected: {describe(fault)}", 500)
        return [fault.title for fault in parsed]

    def check(self, fault: Fault) -> list[ModifierEntry]:
        """Return a fault's modifiers without injecting it; ValueError if it does not fit."""
        if fault.peer is not None:
            self._line(fault.peer)
            return []
        return self._planner.entries(fault, 0)

    def check_all(self, faults: Iterable[Fault]) -> None:
        """ValueError if the plant cannot hold all these faults at once."""
        _expect_places(
            [_note(fault, self.check(fault)) for fault in faults], "leave some out"
        )

    def clear(self, name: str | None = None) -> None:
        """End the fault `name`, or all injected faults; forced signals stay forced.

        ValueError if there is no fault of that name.
        """
        if name is None:
            going = [entry for entry in self._acting() if entry.kind != Kind.FORCE]
            self._mailbox.send([ModifierCommand(lay.OP_CLEAR)])
            self._leave(entry.number for entry in going)
            self._forget(lambda note: note.fault.fault != FORCE)
            for line in self._lines.values():
                line.clear()
            self._watched({"clear": None})
            self._tell("all faults cleared", 300)
            return
        on_line = [line for line in self._lines.values() if line.clear(name)]
        removals = self._removals(name)
        if not removals and not on_line:
            raise ValueError(
                f"there is no fault '{name}'; active are {self.names or 'none'}"
            )
        self._mailbox.send(removals)
        self._leave(command.number for command in removals)
        self._forget(lambda note: note.fault.title == name)
        self._watched({"clear": name})
        self._tell(f"fault cleared: {name}", 300)

    def force(self, signal: str, value: float) -> None:
        """Hold `signal` at `value`, whatever is written or computed."""
        self.inject({"fault": FORCE, "signal": signal, "value": value})

    def unforce(self, signal: str) -> None:
        """Release a forced signal; ValueError if it is not forced."""
        name = f"{FORCE}:{signal}"
        if not self._removals(name):
            raise ValueError(
                f"'{signal}' is not forced; forced are {self.forced or 'none'}"
            )
        self.clear(name)

    def reset(self) -> None:
        """End everything, forces and timed inputs too: the simulation goes back to its start."""
        going = self._acting()
        self._mailbox.send([ModifierCommand(lay.OP_CLEAR_ALL), self._skip])
        self._leave(entry.number for entry in going)
        self._notes.clear()
        for line in self._lines.values():
            line.clear()

    def expect_room(self, faults: Iterable[Fault] = ()) -> None:
        """ControlRefused while the plant has no room for `reset` with `faults` after it."""
        rows = sum(len(self.check(fault)) for fault in faults)
        if self._mailbox.room < _RESET_ROWS + rows:
            raise ControlRefused(
                "the plant has not applied the last faults yet; try again"
            )

    def skip_timed(self) -> None:
        """Drop all waiting timed inputs."""
        self._mailbox.send([self._skip])

    @property
    def _skip(self) -> ModifierCommand:
        return ModifierCommand(lay.OP_SKIP_TIMED, self._mailbox.timed_rows)

    # --- views ------------------------------------------------------------------------------------

    def active(self) -> list[ActiveFault]:
        """Return all that waits or acts: injected faults, forces, faults of links."""
        acting = {entry.number: entry for entry in reversed(self._acting())}
        taken = self._mailbox.tail
        self._notes = {
            number: note
            for number, note in self._notes.items()
            if number in acting or note.mail > taken
        }
        tick = self._tick()
        found = [
            _shown(
                note.fault.title,
                note.fault.fault,
                note.fault.signal or "",
                acting.get(n),
                tick,
            )
            for n, note in self._notes.items()
        ]
        found += [
            self._unknown(entry, tick)
            for number, entry in acting.items()
            if number not in self._notes
        ]
        for line in self._lines.values():
            found += [
                ActiveFault(fault.title, fault.fault, line.name, None, None, is_acting)
                for fault, is_acting in line.active()
            ]
        return found

    @property
    def names(self) -> str:
        """Active faults by name, without forces."""
        return "; ".join(a.name for a in self.active() if a.fault != FORCE)

    @property
    def forced(self) -> str:
        """Forced signals by name."""
        return "; ".join(a.place for a in self.active() if a.fault == FORCE)

    def counts(self) -> dict[str, int]:
        """Return the numbers of acting faults and of forces, for the metric."""
        active = [a for a in self.active() if a.is_acting]
        forces = sum(a.fault == FORCE for a in active)
        return {"injected": len(active) - forces, "forced": forces}

    def figures(self) -> dict[str, dict[str, Figure]]:
        """Return the table that OPC UA shows below ``faults``."""
        active = self.active()
        forces = [a for a in active if a.fault == FORCE]
        injected: dict[str, Figure] = {
            "count": len(active) - len(forces),
            "names": self.names,
        }
        forced: dict[str, Figure] = {"count": len(forces), "names": self.forced}
        timeout: dict[str, Figure] = {
            "fired": self._mailbox.timeouts,
            "holds": self._mailbox.is_silent,
        }
        return {
            "injected": injected,
            "forced": forced,
            "command_timeout": timeout,
        }

    # --- inside -----------------------------------------------------------------------------------

    def _acting(self) -> list[ModifierEntry]:
        """Return the modifiers in the arena that no pending command will end."""
        taken = self._mailbox.tail
        self._leaving = {n: mail for n, mail in self._leaving.items() if mail > taken}
        return [
            entry
            for entry in self._mailbox.acting()
            if entry.number not in self._leaving
        ]

    def _leave(self, numbers: Iterable[int]) -> None:
        self._leaving |= dict.fromkeys(numbers, self._mailbox.head)

    def _start(self, fault: Fault, start_tick: int | None) -> int | None:
        if start_tick is None and fault.from_s > 0:
            return self._tick()
        return start_tick

    def _line(self, peer: str) -> PeerLine:
        if peer not in self._lines:
            known = ", ".join(self._lines) or "none"
            raise ValueError(f"there is no peer '{peer}'; peers are {known}")
        return self._lines[peer]

    def _removals(self, name: str) -> list[ModifierCommand]:
        self.active()
        known = [n for n, note in self._notes.items() if note.fault.title == name]
        known += [
            entry.number
            for entry in self._acting()
            if entry.number not in self._notes and self._unknown(entry, 0).name == name
        ]
        return [
            ModifierCommand(lay.OP_REMOVE, number) for number in dict.fromkeys(known)
        ]

    def _send(
        self, commands: Sequence[ModifierCommand], notes: Mapping[int, _Note]
    ) -> None:
        if not commands:
            return
        removed = {c.number for c in commands if c.operation == lay.OP_REMOVE}
        self.active()
        remaining = {n: note for n, note in self._notes.items() if n not in removed}
        kept = remaining | dict(notes)
        _expect_places(kept.values(), "clear the other faults first")
        self._mailbox.send(commands)
        self._leave(removed)
        self._notes = kept

    def _forget(self, goes: Callable[[_Note], bool]) -> None:
        self._notes = {n: note for n, note in self._notes.items() if not goes(note)}

    def _unknown(self, entry: ModifierEntry, tick: int) -> ActiveFault:
        """Name a modifier that came with a snapshot."""
        kind = Kind(entry.kind)
        if kind is Kind.DEAD_TIMEOUT:
            place = ""
        else:
            place = self._table.by_slot(entry.slot).name
        name = kind.name.lower()
        return _shown(f"{name}:{place}", name, place, entry, tick)

    def _watched(self, command: Mapping[str, Any]) -> None:
        for watcher in self.watchers:
            watcher(command)

    def _tell(self, text: str, severity: int) -> None:
        self._events.publish(Event(EventKind.STATE, severity, "faults", text))


def _shown(
    name: str, fault: str, place: str, entry: ModifierEntry | None, tick: int
) -> ActiveFault:
    if entry is None:
        return ActiveFault(name, fault, place, None, None, is_acting=False)
    until = None if entry.until_tick >= lay.FOREVER else int(entry.until_tick)
    acts = bool(entry.from_tick < tick or entry.start >= 0)
    return ActiveFault(name, fault, place, int(entry.from_tick), until, acts)


def describe(fault: Fault) -> str:
    """Return a fault in one line: its name and all that was given."""
    given = fault.model_dump(
        exclude_defaults=True, exclude={"fault", "name", "signal", "peer"}
    )
    details = ", ".join(f"{key} {value}" for key, value in given.items())
    return f"{fault.title} ({details})" if details else fault.title
