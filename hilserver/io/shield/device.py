"""What the shield does with a request: inputs of the plant that it writes, values it stores."""

import math
import time
from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import Final

from hilserver.config.shield import ShieldConfig
from hilserver.io.shield.protocol import Request, ShieldCommand
from hilserver.io.shield.status import ShieldStatus
from hilserver.io.source import Source
from hilserver.plant.layout import MODE_DUTY, MODE_WHEELS
from hilserver.signals import LIGHTS

NUMBERS: Final = {
    ShieldCommand.IMU_WEIGHT,
    *(
        c
        for c in ShieldCommand
        if ShieldCommand.KP <= c <= ShieldCommand.TICKS_PER_REVOLUTION
    ),
}
"""Commands whose payload is a float to store."""
FLAGS: Final = {
    ShieldCommand.AUX1,
    ShieldCommand.AUX2,
    *(
        c
        for c in ShieldCommand
        if ShieldCommand.PWM_MAX <= c <= ShieldCommand.STALL_CHECK
    ),
}
"""Commands whose payload begins with a byte to store."""
MOTION: Final = frozenset(
    {ShieldCommand.ENABLE, ShieldCommand.SET_RPM, ShieldCommand.SET_PWM}
)
MOST_FREQUENCY_HZ: Final = 1_000_000
"""A greater integer is read as a float: one of the drivers sends the bridge frequency so."""


class ShieldFault(StrEnum):
    """Mistakes of a host."""

    UNTERMINATED = "unterminated"
    SKIPPED_BYTES = "skipped_bytes"
    UNANSWERED = "unanswered"
    UNKNOWN_COMMAND = "unknown_command"
    WHILE_DISABLED = "while_disabled"
    TOO_FAST = "too_fast"
    BAD_NUMBER = "bad_number"
    FREQUENCY_FORM = "frequency_form"
    UNHEARD = "unheard"


class Device:
    """The shield behind its protocol."""

    def __init__(
        self,
        config: ShieldConfig,
        status: ShieldStatus,
        source: Source,
        *,
        max_rpm: float,
        apply: Callable[[float, float], None],
    ) -> None:
        # silence after which enable is withdrawn; the host may change it
        self.limit_ns = round(config.stale_after_ms * 1e6)
        self._config = config
        self._status = status
        self._source = source
        self._max_rpm = max_rpm
        self._apply = apply
        self._wheels = config.wheels

    def take(self, request: Request) -> None:
        """Carry out a request."""
        self._status.requests[request.name] += 1
        if not request.is_terminated:
            self._report(
                ShieldFault.UNTERMINATED,
                request,
                f"{request.name} ends without EE",
                request.name,
            )
            if request.command in MOTION:
                return
        command = request.command
        if command == ShieldCommand.SET_RPM:
            self._set_rpm(request)
        elif command == ShieldCommand.SET_PWM:
            self._set_pwm(request)
        elif command == ShieldCommand.ENABLE:
            self.enable(request)
        elif command == ShieldCommand.DISABLE:
            self.disable(request)
        elif (
            ShieldCommand.LIGHTS_OFF <= command < ShieldCommand.LIGHTS_OFF + len(LIGHTS)
        ):
            red, green, blue = request.payload[:3]
            pattern = request.command - ShieldCommand.LIGHTS_OFF
            colours = {"lights.red": red, "lights.green": green, "lights.blue": blue}
            self._put(request, {"lights.command": pattern, **colours})
        elif command == ShieldCommand.UART_TIMEOUT:
            self._set_timeout(request)
        elif command != ShieldCommand.IMU_RAW:
            self._store(request)

    # --- motion -----------------------------------------------------------------------------------

    def enable(self, request: Request) -> None:
        """Enable the motors, at rest."""
        if not self._status.enabled:
            self._status.enabled = True
            self._put(request, self._at_rest(enabled=True))

    def disable(self, request: Request | None = None) -> None:
        """Disable the motors."""
        self._status.enabled = False
        self._put(request, self._at_rest(enabled=False))

    def _at_rest(self, *, enabled: bool) -> dict[str, object]:
        at_rest = {f"wheel.{wheel}.setpoint_rpm": 0.0 for wheel in self._wheels}
        return {"drive.enable": enabled, "control.mode": MODE_WHEELS, **at_rest}

    def _may_drive(self, request: Request, asked: tuple[float, ...]) -> bool:
        if not self._status.enabled and any(asked):
            text = f"{request.name} without enable: the motors stay off"
            self._report(ShieldFault.WHILE_DISABLED, request, text)
        return self._status.enabled

    def _set_rpm(self, request: Request) -> None:
        speeds = request.speeds_rpm
        if not self._may_drive(request, speeds):
            return
        fastest = max(map(abs, speeds))
        if fastest > self._max_rpm:
            text = f"{fastest:g} rpm commanded, all wheels are scaled to {self._max_rpm:g} rpm"
            self._report(ShieldFault.TOO_FAST, request, text)
            speeds = tuple(rpm * self._max_rpm / fastest for rpm in speeds)
        wheels = zip(self._wheels, speeds, strict=True)
        values: dict[str, object] = {
            f"wheel.{wheel}.setpoint_rpm": rpm for wheel, rpm in wheels
        }
        self._put(
            request, {"drive.enable": True, "control.mode": MODE_WHEELS, **values}
        )

    def _set_pwm(self, request: Request) -> None:
        duties = request.duties_pct
        if not self._may_drive(request, duties):
            return
        values: dict[str, object] = {
            f"wheel.{wheel}.duty_command_pct": float(min(max(duty, -100), 100))
            for wheel, duty in zip(self._wheels, duties, strict=True)
        }
        self._put(request, {"drive.enable": True, "control.mode": MODE_DUTY, **values})

    def _put(self, request: Request | None, values: Mapping[str, object]) -> None:
        now_ns = time.monotonic_ns() if request is None else request.received_ns
        refused = self._source.write(values, now_ns).refused
        if request is not None:
            taken = [name for name in values if name not in refused]
            self._status.input_received_ns.update(dict.fromkeys(taken, now_ns))

    # --- what is stored ---------------------------------------------------------------------------

    def _set_timeout(self, request: Request) -> None:
        seconds = self._number(request)
        if seconds is None or seconds <= 0.0:
            return
        self._status.parameters["uart_timeout_s"] = seconds
        self.limit_ns = round(min(seconds, 1e9) * 1e9)

    def _store(self, request: Request) -> None:
        self._status.without_effect += 1
        name = request.name
        parameters = self._status.parameters
        if request.command in NUMBERS:
            number = self._number(request)
            if number is not None:
                parameters[name] = number
                self._use(request)
        elif request.command in FLAGS:
            parameters[name] = float(request.payload[0])
        elif request.command == ShieldCommand.FREQUENCY:
            parameters[name] = self._frequency_hz(request)
        elif request.command == ShieldCommand.TIMEOUT:
            parameters[name] = float(request.integer)
        elif name == "unknown":
            text = f"command 0x{request.command:02X} is unknown: echoed, without effect"
            self._report(
                ShieldFault.UNKNOWN_COMMAND, request, text, f"{request.command:02X}"
            )

    def _frequency_hz(self, request: Request) -> float:
        if request.integer <= MOST_FREQUENCY_HZ:
            return float(request.integer)
        text = f"frequency is sent as a float ({request.number:g}); the shield takes an integer"
        self._report(ShieldFault.FREQUENCY_FORM, request, text)
        return float(request.integer)

    def _number(self, request: Request) -> float | None:
        if math.isfinite(request.number):
            return request.number
        self._report(
            ShieldFault.BAD_NUMBER,
            request,
            f"{request.name} is not a finite number",
            request.name,
        )
        return None

    def _use(self, request: Request) -> None:
        if self._config.parameters == "store" or request.command not in (
            ShieldCommand.KP,
            ShieldCommand.KI,
        ):
            return
        gains = [self._status.parameters.get(name, math.nan) for name in ("kp", "ki")]
        try:
            self._apply(*gains)
            self._status.without_effect -= 1
        except ValueError as error:
            self._report(ShieldFault.BAD_NUMBER, request, str(error), request.name)

    def _report(
        self, kind: ShieldFault, request: Request, sentence: str, subject: str = "host"
    ) -> None:
        self._source.faults.report(kind, subject, sentence, request.received_ns)
