"""From a fault to the modifiers of the compiled step: seconds to ticks, names to slots."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from hilserver.errors import no_signal
from hilserver.faults.model import Fault
from hilserver.kernel import modifier_layout as lay
from hilserver.kernel.modifier_layout import Kind, ModifierEntry
from hilserver.plant.units import RPM_PER_RAD_S, STANDARD_GRAVITY_M_S2
from hilserver.signals import Direction, Signal, SignalTable, ValueType

DEGREES_PER_RAD = 180.0 / math.pi


_DEFAULTS = {
    "side": lay.NEITHER,
    "from_tick": lay.NOW,
    "until_tick": lay.FOREVER,
    "every": 1,
}


def _entry(kind: Kind, **given: float) -> ModifierEntry:
    """Return a modifier; what is not given is 0, or as in `_DEFAULTS`."""
    entry = ModifierEntry.zeros()
    for name, value in ({"kind": kind} | _DEFAULTS | given).items():
        entry[name] = value
    return entry


@dataclass(frozen=True, slots=True)
class ShieldFigures:
    """Figures that the shield's driver computes with."""

    rpm_per_m_s: float
    rpm_per_rad_s: float
    max_rpm: float


class Planner:
    """Checks faults against the signal table and lays out their modifiers."""

    def __init__(
        self, table: SignalTable, base_period_ns: int, shield: ShieldFigures
    ) -> None:
        self._table = table
        self._period_s = base_period_ns * 1e-9
        self._shield = shield
        self._defects: Mapping[str, Callable[[Fault], list[ModifierEntry]]] = {
            "shield.yaw_rate_without_60_2pi": self._yaw_rate,
            "shield.dead_command_timeout": lambda _: [_entry(Kind.DEAD_TIMEOUT)],
            "shield.last_wheel_scaling": self._last_wheel,
            "shield.front_wheels_swapped": self._front_wheels,
            "shield.rpm_unsigned": self._unsigned,
            "shield.imu_raw_units": self._raw_units,
        }

    def entries(self, fault: Fault, start_tick: int | None) -> list[ModifierEntry]:
        """Return the modifiers of a fault on signals or on the shield.

        `start_tick`: tick from which the fault's times count; None: the one in which it arrives.
        ValueError: one sentence about what does not fit.
        """
        if fault.signal is None:
            found = self._defects[fault.fault](fault)
        else:
            if fault.signal not in self._table or self._table[fault.signal].hidden:
                raise ValueError(
                    no_signal(fault.signal, (signal.name for signal in self._table))
                )
            if fault.signal.startswith("sim."):
                raise ValueError(
                    f"'{fault.signal}' shows time or state, which no fault can change"
                )
            signal = self._table[fault.signal]
            found = self._on_signal(fault, signal)
        begin = round(fault.from_s / self._period_s)
        from_tick = lay.NOW if start_tick is None else start_tick + begin
        until_tick = lay.FOREVER
        if fault.end_s is not None:
            end = max(round(fault.end_s / self._period_s), begin + 1)
            until_tick = end if start_tick is None else start_tick + end
        for entry in found:
            entry.from_tick = from_tick
            entry.until_tick = until_tick
        return found

    def _side(self, signal: Signal) -> int:
        return lay.INPUT if signal.direction is Direction.IN else lay.OUTPUT

    def _ticks(self, seconds: float | None) -> int:
        if seconds is None:
            return 0
        return max(1, round(seconds / self._period_s))

    def _on_signal(self, fault: Fault, signal: Signal) -> list[ModifierEntry]:
        kind = Kind[fault.fault.upper()]
        if kind is Kind.FORCE or (kind is Kind.STUCK and fault.value is not None):
            check_range(signal, fault.value or 0.0)
        ticks = self._ticks(fault.delay_s)
        spread = self._ticks(fault.jitter_s)
        if ticks + spread > lay.MAX_DELAY_TICKS:
            limit_s = lay.MAX_DELAY_TICKS * self._period_s
            raise ValueError(f"{fault.fault} reaches back at most {limit_s:g} s")
        numbers = (
            fault.value,
            fault.sd,
            fault.offset,
            fault.factor,
            fault.step,
            fault.size,
        )
        fields = {
            "side": self._side(signal),
            "seed": fault.seed or 0,
            "every": max(1, self._ticks(fault.every_s)),
            "ticks": ticks,
            "spread": spread,
            "a": next((number for number in numbers if number is not None), 0.0),
            "b": fault.value is not None
            if kind is Kind.STUCK
            else fault.probability or 0.0,
            "is_integer": signal.type is not ValueType.DOUBLE,
            "low": signal.low,
            "high": signal.high,
        }
        return [
            _entry(kind, slot=slot, channel=slot * len(Kind) + int(kind), **fields)
            for slot in signal.slots
        ]

    # --- the robot stack's own defects ------------------------------------------------------------

    def _scaled(self, name: str, factor: float) -> ModifierEntry:
        signal = self._table[name]
        return _entry(
            Kind.SCALE, slot=signal.slots[0], side=self._side(signal), a=factor
        )

    def _yaw_rate(self, _: Fault) -> list[ModifierEntry]:
        return [self._scaled("twist.angular_rad_s", 1.0 / RPM_PER_RAD_S)]

    def _last_wheel(self, fault: Fault) -> list[ModifierEntry]:
        slot = self._table.slot
        limit = fault.value
        if limit is not None and limit <= 0:
            raise ValueError(f"value is a speed above 0 rpm, not {limit:g}")
        most_rpm = self._shield.max_rpm if limit is None else limit
        return [
            _entry(
                Kind.LAST_WHEEL,
                slot=slot("twist.linear_m_s"),
                other=slot("twist.angular_rad_s"),
                side=lay.INPUT,
                a=self._shield.rpm_per_m_s,
                b=self._shield.rpm_per_rad_s,
                c=most_rpm,
            )
        ]

    def _front_wheels(self, _: Fault) -> list[ModifierEntry]:
        left, right = (
            self._table.slot(f"wheel.{wheel}.speed_rpm") for wheel in ("fl", "fr")
        )
        return [_entry(Kind.SWAP, slot=left, other=right, side=lay.OUTPUT)]

    def _unsigned(self, _: Fault) -> list[ModifierEntry]:
        slots = self._table["wheels.speeds_rpm"].slots
        return [_entry(Kind.UNSIGNED, slot=slot, side=lay.OUTPUT) for slot in slots]

    def _raw_units(self, _: Fault) -> list[ModifierEntry]:
        gyro = self._scaled("imu.gyro_z_rad_s", DEGREES_PER_RAD)
        ahead = self._scaled("imu.accel_x_m_s2", 1.0 / STANDARD_GRAVITY_M_S2)
        aside = self._scaled("imu.accel_y_m_s2", 1.0 / STANDARD_GRAVITY_M_S2)
        return [gyro, ahead, aside]


def check_range(signal: Signal, value: float) -> None:
    """Raise ValueError if the signal cannot have `value`."""
    if not signal.low <= value <= signal.high:
        raise ValueError(
            f"{signal.name} = {value:g} is outside {signal.low:g} .. {signal.high:g} {signal.unit}"
        )
    if signal.type is not ValueType.DOUBLE and value != int(value):
        raise ValueError(f"{signal.name} takes whole numbers, not {value:g}")
