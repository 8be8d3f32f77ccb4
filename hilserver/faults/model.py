"""What a fault is, as it stands in a scenario, in InjectFault's JSON and in a test."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from hilserver.config.loading import checked
from hilserver.config.section import Section
from hilserver.errors import ConfigError

MAX_NUMBER = 1e12
MAX_JSON = 65536
Number = Annotated[float, Field(ge=-MAX_NUMBER, le=MAX_NUMBER)]
Positive = Annotated[float, Field(gt=0, le=MAX_NUMBER)]
Seconds = Annotated[float, Field(ge=0, le=1e7)]


@dataclass(frozen=True, slots=True)
class Form:
    """Parameters of one kind of fault, and where it can sit."""

    text: str
    # parameters that must, or may, be given
    needs: tuple[str, ...] = ()
    takes: tuple[str, ...] = ()
    on: tuple[str, ...] = ("signal",)  # ``signal``, ``peer`` or neither


_BOTH = ("signal", "peer")
FORMS: Mapping[str, Form] = {
    "stuck": Form("keeps its value, or `value`", takes=("value",)),
    "noise": Form(
        "Gaussian noise of standard deviation `sd` is added", ("sd",), ("every_s",)
    ),
    "bias": Form("`offset` is added", ("offset",)),
    "scale": Form("multiplied by `factor`", ("factor",)),
    "delay": Form("arrives `delay_s` late", ("delay_s",), on=_BOTH),
    "jitter": Form(
        "arrives `delay_s` plus 0 .. `jitter_s` late, in order",
        ("jitter_s",),
        ("delay_s", "every_s"),
        _BOTH,
    ),
    "drop": Form(
        "a sample is lost with `probability`; the last one stays",
        ("probability",),
        ("every_s",),
        _BOTH,
    ),
    "reorder": Form(
        "with `probability`, the sample from `delay_s` ago replaces the present one",
        ("probability", "delay_s"),
        ("every_s",),
        _BOTH,
    ),
    "hold": Form("sampled every `every_s`, held in between", ("every_s",)),
    "quantise": Form("rounded to multiples of `step`", ("step",)),
    "spike": Form(
        "with `probability`, `size` is added or subtracted",
        ("size", "probability"),
        ("every_s",),
    ),
    "disconnect": Form(
        "keeps its value, quality Uncertain; a link is interrupted", on=_BOTH
    ),
    "force": Form("is `value`, whatever is written", ("value",)),
    "shield.yaw_rate_without_60_2pi": Form(
        "defect 1: the factor 60/(2 pi) is missing, turning is 9.5 times too slow",
        on=(),
    ),
    "shield.dead_command_timeout": Form(
        "defect 2: the command time-out never fires, the robot drives on", on=()
    ),
    "shield.last_wheel_scaling": Form(
        "defect 3: wheels faster than `value` rpm (default: max_rpm) are scaled by the last of"
        " them, not by the fastest",
        takes=("value",),
        on=(),
    ),
    "shield.front_wheels_swapped": Form(
        "defect 4: the front wheels are swapped in the published speeds", on=()
    ),
    "shield.rpm_unsigned": Form(
        "defect 5: speeds are read as unsigned 16-bit numbers", on=()
    ),
    "shield.imu_raw_units": Form("defect 5: IMU in g and degrees per second", on=()),
}
"""Every fault by name."""

PARAMETERS = (
    "value",
    "sd",
    "offset",
    "factor",
    "delay_s",
    "jitter_s",
    "probability",
    "every_s",
    "step",
    "size",
)
if TYPE_CHECKING:
    KindName = str
else:
    KindName = Literal[tuple(FORMS)]


def _conditions(schema: dict[str, Any]) -> None:
    """Add to the JSON Schema which kind needs which keys."""
    schema["allOf"] = [
        {
            "if": {"properties": {"fault": {"const": kind}}},
            "then": {
                "required": list(form.needs)
                + (list(form.on) if len(form.on) == 1 else []),
                "properties": {
                    key: False
                    for key in (*PARAMETERS, "signal", "peer")
                    if key not in (*form.needs, *form.takes, *form.on)
                },
            },
        }
        for kind, form in FORMS.items()
    ]


class Fault(Section):
    """One fault on a signal, a peer link or the simulated shield; times count from the start."""

    model_config = ConfigDict(json_schema_extra=_conditions)

    fault: KindName = Field(description="kind of fault")
    name: str | None = Field(
        None,
        pattern=r"^[A-Za-z0-9_.:-]{1,100}$",
        description="name to end it by; another fault of that name is replaced",
    )
    signal: str | None = Field(
        None, description="signal it acts on; arrays are possible"
    )
    peer: str | None = Field(None, description="peer link it acts on")
    direction: Literal["in", "out", "both"] = Field(
        "both", description="of a peer link: incoming or outgoing values"
    )
    from_s: Seconds = Field(0.0, description="begins this long after the start [s]")
    until_s: Seconds | None = Field(
        None, description="ends this long after the start [s]"
    )
    for_s: Positive | None = Field(None, description="lasts this long [s]")
    seed: int | None = Field(
        None,
        ge=0,
        lt=2**31,
        description="of noise, drop, jitter, reorder, spike; null: the scenario's, or 0",
    )
    value: Number | None = Field(None, description="in the signal's unit")
    sd: Positive | None = Field(None, description="standard deviation, signal's unit")
    offset: Number | None = Field(None, description="signal's unit")
    factor: Number | None = Field(None, description="without a unit")
    delay_s: Positive | None = Field(None, description="[s]")
    jitter_s: Positive | None = Field(None, description="[s]")
    probability: float | None = Field(None, ge=0, le=1, description="for each sample")
    every_s: Positive | None = Field(
        None, description="length of a sample [s]; default: a tick"
    )
    step: Positive | None = Field(None, description="signal's unit")
    size: Positive | None = Field(None, description="signal's unit")

    @model_validator(mode="after")
    def _fits_its_form(self) -> Self:
        form = FORMS[self.fault]
        given = [key for key in PARAMETERS if getattr(self, key) is not None]
        for key in form.needs:
            if key not in given:
                raise ValueError(f"{self.fault} needs '{key}'")
        for key in given:
            if key not in (*form.needs, *form.takes):
                known = ", ".join((*form.needs, *form.takes)) or "no parameters"
                raise ValueError(
                    f"{self.fault} does not take '{key}', it takes {known}"
                )
        places = [key for key in _BOTH if getattr(self, key) is not None]
        if len(places) > 1 or any(place not in form.on for place in places):
            raise ValueError(
                f"{self.fault} acts on {' or '.join(form.on) or 'the whole shield'}"
            )
        if form.on and not places:
            raise ValueError(f"{self.fault} needs '{form.on[0]}'")
        if self.until_s is not None and self.for_s is not None:
            raise ValueError("give until_s or for_s, not both")
        if self.until_s is not None and self.until_s <= self.from_s:
            raise ValueError(f"until_s is {self.until_s:g}, it must be above from_s")
        return self

    @property
    def title(self) -> str:
        """Its name, or one made from its kind and place."""
        place = self.signal or self.peer
        return self.name or (f"{self.fault}:{place}" if place else self.fault)

    @property
    def end_s(self) -> float | None:
        """End of the fault, counted like `from_s` [s]; None: never."""
        if self.for_s is None:
            return self.until_s
        return self.from_s + self.for_s


def parse_fault(data: object) -> Fault:
    """Return a fault from plain data; ValueError with one sentence that names the key."""
    if isinstance(data, Fault):
        return data
    if not isinstance(data, dict):
        raise ValueError(
            "a fault is a mapping like {'fault': 'bias', 'signal': ..., 'offset': 1}"
        )
    try:
        return checked(Fault, data)
    except ConfigError as error:
        raise ValueError(str(error)) from None


def parse_faults(text: str) -> list[Fault]:
    """Return the faults of a JSON text, an object or a list; ValueError if it is neither."""
    if len(text) > MAX_JSON:
        raise ValueError(f"the text is longer than {MAX_JSON} characters")
    try:
        data = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"not JSON: {error}") from None
    return [parse_fault(item) for item in (data if isinstance(data, list) else [data])]
