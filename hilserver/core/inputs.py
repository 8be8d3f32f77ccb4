"""The only door for values into the plant.

Every source (OPC UA client, peer, scenario, page, ROS 2) writes through the `InputGate`. It checks
name, type, finiteness and range, asks who is in control, and pushes the accepted values as one
group that one tick latches. A refused value is counted, published as an event, and goes no further.
"""

import math
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

from hilserver.config.doors import DoorRule, Right
from hilserver.core.events import Event, EventBus, EventKind
from hilserver.core.handover import HandOver
from hilserver.core.leases import NOBODY, OFFERING, Leases, kind_of
from hilserver.core.refusal import (
    CHOOSING,
    SENTENCES,
    Refusal,
    check_value,
    reasons_of,
    spoiled,
)
from hilserver.core.rest import Interlock, Rest, is_hand
from hilserver.image import ProcessImage, Row
from hilserver.plant.layout import N_COMMANDS, N_SETPOINTS
from hilserver.signals import (
    MEASURED,
    SAMPLED,
    SOURCES,
    Signal,
    SignalTable,
)
from hilserver.status import (
    BAD_WAITING_FOR_INITIAL_DATA,
    UNCERTAIN_LAST_USABLE_VALUE,
)

_MOST_DENIED = 64  # sources whose refusal was reported, until they have control
# refusals beside another writer that were reported, until it has gone
_MOST_REPORTED = 256
# for so long a client without a link holds what it has written
_HELD_NS = 1_000_000_000
_GRAIN_NS = 20_000_000  # accuracy of the time at which a command came in


class InputGate(HandOver):
    """Checks what sources write and hands it to the plant.

    Parameters
    ----------
    owner, priority, fallback
        See `HandOver`.
    named : collection of str
        Sources that the configuration names, for metrics; any other counts as its kind.
    doors : iterable of DoorRule
        Doors without a log-in, and what they allow.
    waits_for_start : bool
        Whether automatic sources wait for Start after a safe state, see `Interlock`.
    monotonic_ns : callable
        Clock that stamps incoming values.
    """

    def __init__(
        self,
        table: SignalTable,
        image: ProcessImage,
        events: EventBus,
        leases: Leases,
        *,
        owner: str = "opcua",
        priority: Sequence[str] = SOURCES,
        fallback: str = NOBODY,
        named: Collection[str] = SOURCES,
        doors: Iterable[DoorRule] = (),
        waits_for_start: bool = False,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        super().__init__(image, events, leases, owner, priority, fallback)
        self._named = frozenset(named)
        self._doors = {door.source: door for door in doors if door.is_open}
        # Counts exist before the first refusal: the increase of a series begins at its first value.
        self.rejected: Counter[tuple[str, str]] = Counter()
        for source in named:
            is_door = source in {self.label(door) for door in self._doors}
            reasons = reasons_of(source, is_door=is_door)
            self.rejected.update({(source, reason.value): 0 for reason in reasons})
        self._table = table
        self._now_ns = monotonic_ns
        self._ended_ns = 0
        self._rest = Rest()
        self.interlock = Interlock(table, image, must_wait=waits_for_start)
        self._last_ns: dict[str, int] = {}
        self._newest: dict[int, tuple[str, float]] = {}
        self._change: tuple[int, int] | None = None
        self._denied: dict[str, str] = {}
        # slot: who writes it, and since when last
        self._writing: dict[int, tuple[str, int]] = {}
        # links that have nothing new to say: others may write
        self._silent: set[str] = set()
        # refused source and signal: beside whom
        self._reported: dict[tuple[str, str], str] = {}
        # told to let go first, or that they wait for Start
        self._held: set[str] = set()
        self._counted = {g for g in SAMPLED if f"internal.samples_{g}" in table}
        self._samples: Counter[str] = Counter()

    def write(
        self,
        source: str,
        values: Mapping[str, object],
        *,
        received_ns: int | None = None,
        commanded_ns: int | None = None,
        age_ns: int = 0,
        news: Collection[str] | None = None,
        renews: bool = True,
        by_hand: bool = False,
        broken: Collection[str] = (),
    ) -> dict[str, Refusal]:
        """Check `values` and hand the accepted ones, as one group, to the next tick.

        A command is whole or not at all: where a wheel's set-point is refused, those of the other
        wheels are, too, and the mode that came with them. The same holds for twist and duties.
        `drive.enable` and measured values stand alone.

        Parameters
        ----------
        source : str
            ``opcua``, ``page``, ``scenario``, ``shield``, ``ros2`` or ``peer:<name>``.
        values : mapping
            Signal name to number, Boolean, or four numbers for an array.
        received_ns : int, optional
            When they came in, by CLOCK_MONOTONIC; now by default.
        commanded_ns : int, optional
            When their lease begins: earlier if they waited to be read; `received_ns` by default.
        age_ns : int
            How long before `received_ns` their source sampled them.
        news : collection of str, optional
            Signals whose values are new samples, not repeated ones; by default all.
        renews : bool
            Whether to renew the lease of the source; False while it lacks an input.
        by_hand : bool
            Whether a person drives by this source, of which its name does not tell.
        broken : collection of str
            What else the source wrote by the same request, and what was refused before it came
            here; a name that is no signal may have meant any command.

        Returns
        -------
        dict of Refusal
            The refused signals; empty when all were accepted.
        """
        now_ns = self._now_ns() if received_ns is None else received_ns
        came_ns = now_ns if commanded_ns is None else commanded_ns
        self._silent.discard(source)
        rows, offers, refused = self._sort(
            source, values, came_ns < self._ended_ns, now_ns
        )
        wrong = refused.keys() - offers.keys()
        lost = spoiled(wrong.union(broken), self._table)
        for name in [*rows, *offers]:
            slots = self._table[name].slots
            if not lost.isdisjoint(slots):
                refused[name] = Refusal.INCOMPLETE
                rows.pop(name, None)
                offers.pop(name, None)
        offered = [row for found in offers.values() for row in found]

        by_hand = by_hand or is_hand(source)
        is_waiting = not by_hand and self.interlock.holds(kind_of(source))
        group = offered + [row for found in rows.values() for row in found]
        setpoints = [row.value for row in group if row.slot < N_SETPOINTS]
        why: Refusal | None = None
        if (
            by_hand
            and setpoints
            and not self._rest.lets_move(source, setpoints, now_ns)
        ):
            why = Refusal.NOT_AT_REST
        elif is_waiting and any(setpoints):
            why = Refusal.NOT_STARTED
        if why is not None:
            held = [name for name, found in rows.items() if found[0].slot < N_COMMANDS]
            refused |= dict.fromkeys(held, why)
            rows = {name: rows[name] for name in rows if name not in held}
            group = [row for found in rows.values() for row in found]

        speaker = self._speaker
        placed = self._passed_on(source, group)
        is_renewed = renews and not is_waiting and not lost
        placed += self._placed(source, group, came_ns if is_renewed else None)
        fresh = rows if news is None else rows.keys() & news
        placed += self._sampled(fresh, now_ns, age_ns)
        if placed and not self._image.push(placed):
            refused |= dict.fromkeys(rows, Refusal.QUEUE_FULL)
            rows = {}
            self._speaker = speaker

        if rows:
            self._remember(source, rows.values(), now_ns)
        for name in rows:
            self._reported.pop((source, name), None)
        for name, reason in refused.items():
            self._report(source, name, values[name], reason)
        return refused

    def _sort(
        self, source: str, values: Mapping[str, object], is_outdated: bool, now_ns: int
    ) -> tuple[dict[str, list[Row]], dict[str, list[Row]], dict[str, Refusal]]:
        """Return accepted rows, rows kept as an offer, and refusals, all by signal."""
        rows: dict[str, list[Row]] = {}
        offered: dict[str, list[Row]] = {}
        refused: dict[str, Refusal] = {}
        kind = kind_of(source)
        door = self._doors.get(source) or self._doors.get(kind)  # one of its topics
        for name, value in values.items():
            checked = self._check(name, value)
            if isinstance(checked, Refusal):
                refused[name] = checked
                continue
            signal = self._table[name]
            right = Right.MEASURED if signal.is_measured else Right.COMMAND
            if door is not None and right not in door.rights:
                refused[name] = Refusal.NOT_GRANTED
                continue
            if self._other_writer(source, signal, now_ns):
                refused[name] = Refusal.NOT_IN_CONTROL
                continue
            found = [Row(s, v) for s, v in zip(signal.slots, checked, strict=True)]
            if signal.is_measured or kind in OFFERING:
                self._writing |= dict.fromkeys(signal.slots, (source, now_ns))
            if signal.is_measured or (kind == self.owner and not is_outdated):
                rows[name] = found
                continue
            refused[name] = Refusal.OUTDATED if is_outdated else Refusal.NOT_IN_CONTROL
            if kind in OFFERING and not is_outdated:
                offered[name] = [row for row in found if row.slot < N_COMMANDS]
        return rows, offered, refused

    def _other_writer(self, source: str, signal: Signal, now_ns: int) -> str:
        """Return who writes this signal already, if that is somebody else; two never mix.

        Among peers, and for measured values, the first to write keeps a signal until it falls
        silent. A door without a log-in yields to the person who drives.
        """
        if not signal.is_measured and kind_of(source) not in OFFERING:
            is_beside = source in self._doors and kind_of(source) == self.owner
            if is_beside and self._is_driven_by_a_person(source):
                return self.owner
            return ""
        for slot in signal.slots:
            writer, last_ns = self._writing.get(slot, ("", 0))
            if writer in ("", source) or writer in self._silent:
                continue
            if signal.is_measured or kind_of(writer) == kind_of(source):
                # whose silence is judged elsewhere
                is_link = kind_of(writer) in OFFERING
                if is_link or now_ns - last_ns < _HELD_NS:
                    return writer
        return ""

    def _is_driven_by_a_person(self, door: str) -> bool:
        """Whether somebody else of this door's kind moves the robot now."""
        speaker = self._speaker
        if speaker in ("", door) or speaker in self._doors:
            return False
        newest = (self._newest.get(slot, ("", 0.0)) for slot in range(N_SETPOINTS))
        return any(writer == speaker and value != 0.0 for writer, value in newest)

    def renew(self, source: str, came_ns: int) -> None:
        """Renew the lease of a source that sent something at `came_ns`, but no command."""
        if is_hand(source) or not self.interlock.holds(kind_of(source)):
            self.leases.renew(source, came_ns)

    def stamps(
        self, names: Iterable[str], time_s: float, age_s: float = 0.0, tick: int = 0
    ) -> list[Row]:
        """Return rows that count a sample of each measured group, in simulated time."""
        named_groups = {n.split(".")[1] for n in names if n.startswith(MEASURED)}
        groups = named_groups & self._counted
        self._samples.update(groups)
        rows: list[Row] = []
        for group in sorted(groups):
            news = {f"samples_{group}": self._samples[group], f"time_{group}_s": time_s}
            news[f"taken_{group}_s"] = max(time_s - age_s, 0.0)
            rows += [
                Row(self._table.slot(f"internal.{n}"), v, tick=tick)
                for n, v in news.items()
            ]
        return rows

    def _sampled(self, names: Iterable[str], now_ns: int, age_ns: int) -> list[Row]:
        """Return the stamps of values that came in at `now_ns` (CLOCK_MONOTONIC)."""
        frame = self._image.latest() if self._counted else None
        if frame is None:
            return self.stamps(names, 0.0)
        shown_s = float(frame.values[self._table.slot("sim.time_s")])
        time_s = max(shown_s + (now_ns - frame.planned_ns) * 1e-9, 0.0)
        return self.stamps(names, time_s, age_ns * 1e-9)

    def _placed(
        self, source: str, rows: list[Row], came_ns: int | None = None
    ) -> list[Row]:
        """Return rows for the place of the source's kind; commands renew its lease at `came_ns`."""
        kind = kind_of(source)
        place = self.leases.place
        placed = [row._replace(slot=place(kind, row.slot)) for row in rows]
        is_command = any(not self._table.by_slot(row.slot).is_measured for row in rows)
        if is_command and came_ns is not None:
            placed += self.leases.renewal(source, came_ns)
        return placed

    def _check(self, name: str, value: object) -> tuple[float, ...] | Refusal:
        if name not in self._table or self._table[name].hidden:
            return Refusal.UNKNOWN_SIGNAL
        signal = self._table[name]
        if not signal.writable:
            return Refusal.NOT_WRITABLE
        return check_value(signal, value)

    def _remember(self, source: str, groups: Iterable[list[Row]], now_ns: int) -> None:
        self._denied.pop(source, None)
        changed = False
        for row in (row for group in groups for row in group):
            before = self._newest.get(row.slot)
            changed |= before is None or before[1] != row.value
            self._newest[row.slot] = source, row.value
        self._last_ns[self.label(source)] = now_ns
        if changed and self._change is None:
            self._change = (now_ns, self._image.pushed_rows)

    def _report(self, source: str, name: str, value: object, reason: Refusal) -> None:
        if reason is Refusal.INCOMPLETE:
            return  # nothing is wrong with it; what is wrong is reported
        other = ""
        if reason is Refusal.NOT_IN_CONTROL:
            other = self._other_writer(source, self._table[name], self._now_ns())
        if other or reason is Refusal.NOT_GRANTED:
            self.rejected[(self.label(source), reason.value)] += 1
            if self._reported.get((source, name)) == (other or reason.value):
                return
            if len(self._reported) >= _MOST_REPORTED:
                self._reported.pop(next(iter(self._reported)))
            self._reported[source, name] = other or reason.value
            self._tell_refused(source, name, value, reason)
            return
        is_denied = (
            reason is Refusal.NOT_IN_CONTROL and self._denied.get(source) == self.owner
        )
        if kind_of(source) in OFFERING and (is_denied or reason is Refusal.NOT_STARTED):
            # it repeats itself: an offer is kept, and after Start it says it again
            return
        self.rejected[(self.label(source), reason.value)] += 1
        is_held_back = reason in (Refusal.NOT_AT_REST, Refusal.NOT_STARTED)
        if is_denied or (is_held_back and source in self._held):
            return
        if is_held_back:
            self._held.add(source)
        if reason is Refusal.NOT_IN_CONTROL:
            if len(self._denied) >= _MOST_DENIED:
                self._denied.pop(next(iter(self._denied)))
            self._denied[source] = self.owner
        self._tell_refused(source, name, value, reason)

    def _tell_refused(
        self, source: str, name: str, value: object, reason: Refusal
    ) -> None:
        why = self.explain(source, name, reason)
        text = f"{source}: {name} = {value!r:.60} refused: {why}"
        self._events.publish(Event(EventKind.SETPOINT_REFUSED, 400, source, text))

    def explain(self, source: str, name: str, reason: Refusal) -> str:
        """Return the reason in words."""
        if reason is Refusal.NOT_IN_CONTROL:
            kind = kind_of(source)
            other = self._other_writer(source, self._table[name], self._now_ns())
            if other == self.owner:
                return f"a person drives by '{other}'"
            if other:
                return f"'{other}' writes it, until it falls silent"
            if kind == "page":  # whoever uses it sees a button, not a signal
                return f"'{self.owner}' has control; take control on the page first"
            return f"'{self.owner}' has control; write '{kind}' to control.source to take it"
        if reason is Refusal.NOT_GRANTED:
            door = self._doors.get(source) or self._doors[kind_of(source)]
            right = "measured" if self._table[name].is_measured else "command"
            return (
                f"{door.title} knows no log-in, and {door.key} does not name '{right}'"
            )
        if reason in SENTENCES:
            return SENTENCES[reason]
        if reason is Refusal.OUT_OF_RANGE:
            return f"outside {self._table[name].range_text}"
        if reason is Refusal.TYPE_MISMATCH:
            signal = self._table[name]
            if signal.is_array:
                wanted = f"{len(signal.slots)} values of type"
            else:
                wanted = "a value of type"
            return f"{wanted} {signal.type} expected"
        return reason.value.replace("_", " ")

    def publish(self, event: Event) -> None:
        """Tell what a client has done."""
        self._events.publish(event)

    def mark_stale(self, source: str) -> None:
        """Keep the last values of the source, with status UncertainLastUsableValue."""
        slots = [slot for slot, (writer, _) in self._newest.items() if writer == source]
        rows = [Row(slot, math.nan, UNCERTAIN_LAST_USABLE_VALUE) for slot in slots]
        self.let_go(source)
        self._image.push(self._placed(source, rows))

    def let_go(self, source: str) -> None:
        """Let others write what the source has written: it is silent."""
        self._silent.add(source)

    def expect(self, source: str, names: Iterable[str]) -> None:
        """Mark signals that a configured source will write: BadWaitingForInitialData until then."""
        rows = [
            Row(slot, self._table.by_slot(slot).initial, BAD_WAITING_FOR_INITIAL_DATA)
            for name in names
            for slot in self._table[name].slots
        ]
        self._image.push(self._placed(source, rows))

    def end(self) -> None:
        """End every lease: nothing is commanded until a source sends a new command."""
        self.outdate()
        self._image.push([self.leases.end()])
        for slot in range(N_SETPOINTS):
            self._newest.pop(slot, None)

    def end_waiting(self) -> None:
        """Outdate commands, also those that the plant will latch after it has ended its leases.

        Those of a scenario stay: it may begin anew in the same tick.
        """
        self.outdate()
        if self.owner in CHOOSING:
            places = (
                self.leases.place(self.owner, slot) for slot in range(N_SETPOINTS)
            )
            self._image.push([Row(place, 0.0) for place in places])

    def outdate(self) -> None:
        """Refuse commands that have come in before now and still wait to be read."""
        self._ended_ns = self._now_ns() - _GRAIN_NS
        self._rest.end(self._now_ns())
        self._held.clear()
        self._writing.clear()

    def age_s(self, source: str) -> float | None:
        """Return the time since the source's last accepted write [s], None before the first."""
        last = self._last_ns.get(self.label(source))
        return None if last is None else (self._now_ns() - last) * 1e-9

    @property
    def sources(self) -> tuple[str, ...]:
        """Every source that has written so far, as metrics name it."""
        return tuple(self._last_ns)

    def label(self, source: str) -> str:
        """Return the name of a source in metrics: never one that a client has made."""
        return source if source in self._named else kind_of(source)

    @property
    def measured(self) -> tuple[str, ...]:
        """Channels of the real robot that some source has written: ``wheel.fl.speed_rpm`` ..."""
        signals = (self._table.by_slot(slot) for slot in sorted(self._newest))
        return tuple(s.name.removeprefix(MEASURED) for s in signals if s.is_measured)

    def accepted_value(self, name: str) -> tuple[float, ...]:
        """Return the last accepted value of a signal, one number per slot."""
        slots = self._table[name].slots
        return tuple(self._newest[slot][1] for slot in slots)

    def newest(self, name: str) -> float | None:
        """Return the newest accepted value of a scalar, which the next tick latches; or None."""
        found = self._newest.get(self._table.slot(name))
        return None if found is None else found[1]

    @property
    def is_disabled_by_host(self) -> bool:
        """Whether the source in control has disabled the drive by what it wrote last."""
        slot = self._table.slot("drive.enable")
        source, value = self._newest.get(slot, ("", 1.0))
        return kind_of(source) == self.owner and not value

    def take_change(self, latched_rows: int) -> int | None:
        """Return when the oldest unpublished change came in [ns], once a frame contains it."""
        if self._change is None or latched_rows < self._change[1]:
            return None
        received_ns = self._change[0]
        self._change = None
        return received_ns
