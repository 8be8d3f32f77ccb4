"""The variables of the robot's FMU: signals by their names, parameters that can be tuned."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from math import inf, isnan, nextafter
from typing import Final
from xml.sax.saxutils import quoteattr

from hilserver import __version__
from hilserver.parameters import PLANT, Parameter, read
from hilserver.parameters.table import EXCLUSIVE, SECTIONS, TERM
from hilserver.plant.layout import Inputs, Outputs
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.physical import TERM_NAMES, Physical, physical
from hilserver.plant.terms import TERMS
from hilserver.signals import Signal, SignalTable

N_U, N_Y = Inputs.n_words, Outputs.n_words
FIRST_INPUT, FIRST_OUTPUT, FIRST_TUNABLE = 1, 1000, 2000  # value references; time has 0


@dataclass(frozen=True)
class Tunable:
    """A parameter: one of the physical numbers. Where it can be null, 0 is null."""

    about: Parameter
    place: int  # index among the physical numbers
    start: float  # the robot's value; 0: null
    # range, ends included
    low: float
    high: float


def inputs(table: SignalTable) -> list[Signal]:
    """Return the inputs in the order of `u`, the daemon's hidden ones included."""
    return sorted(
        (s for s in table.scalars if s.slots[0] < N_U), key=lambda s: s.slots[0]
    )


def outputs(table: SignalTable) -> list[Signal]:
    """Return the outputs in the order of `y`."""
    found = (s for s in table.scalars if N_U <= s.slots[0] < N_U + N_Y)
    return sorted(found, key=lambda s: s.slots[0])


def tunables(robot: RobotParameters) -> list[Tunable]:
    """Return the parameters of this robot that act at a tick."""
    # Used only when the FMU is made, or without meaning for the robot.
    causes = {"friction_anisotropy", *robot.meaningless}
    fixed = {f"{TERM}{name}" for name, term in TERMS.items() if term.cause in causes}
    fixed.add("sensors.battery.initial_charge")  # acts on the initial state only
    if robot.is_mecanum:
        fixed.add("plant.icr_offset_m")
    made = physical(robot)
    if made.anisotropy_factor != 1.0 or made.anisotropy_shift_m != 0.0:
        fixed |= {"plant.wheelbase_m", "plant.track_m"}
    found = [
        Tunable(
            PLANT[name],
            _place(name),
            0.0 if isnan(value) else value,
            *_range(PLANT[name]),
        )
        for name, value in read(robot).items()
        if PLANT[name].when == "tick" and name not in fixed
    ]
    seed = Parameter(
        "seed", "1", 0, 2.0**53 - 1, 0, nullable=False, meaning="seed of all noise"
    )
    seed_row = Tunable(seed, _place("seed"), float(robot.seed), seed.low, seed.high)
    return [
        *found,
        seed_row,
    ]


def _place(name: str) -> int:
    if name == EXCLUSIVE:
        name = "exclusive"
    known = TERM_NAMES.get(name.removeprefix(TERM))
    for section in ("plant.", "sensors.", "kinematics."):
        name = name.removeprefix(section)
    place: slice = Physical.where(known or name.replace(".", "_"))
    return int(place.start)


def _range(about: Parameter) -> tuple[float, float]:
    """Return the lowest and highest value; an excluded bound is moved to the next number."""
    section, _, key = about.name.rpartition(".")
    part = SECTIONS.get(section)
    own = {} if part is None else {item.name: item for item in fields(part)}
    bounds = own[key].metadata.get("bounds", {}) if key in own else {}
    low = nextafter(about.low, inf) if "gt" in bounds else about.low
    return low, nextafter(about.high, -inf) if "lt" in bounds else about.high


def description(
    version: int,
    table: SignalTable,
    tunable: Sequence[Tunable],
    step_s: float,
    token: str,
) -> str:
    """Return the modelDescription.xml of FMI 2.0 or 3.0."""
    rows: list[str] = []
    signal_units = {s.unit for s in (*inputs(table), *outputs(table))}
    units = signal_units | {t.about.unit for t in tunable}
    rows.append(
        _row(version, "time", 0, 'causality="independent" variability="continuous"', "")
    )
    for i, s in enumerate(inputs(table)):
        what = f'causality="input" variability="discrete" description={quoteattr(s.description)}'
        more = f'{_unit(s.unit)} min="{s.low:.17g}" max="{s.high:.17g}" start="{s.initial:.17g}"'
        rows.append(_row(version, s.name, FIRST_INPUT + i, what, more))
    for i, s in enumerate(outputs(table)):
        what = f'causality="output" variability="discrete" description={quoteattr(s.description)}'
        rows.append(_row(version, s.name, FIRST_OUTPUT + i, what, _unit(s.unit)))
    for i, t in enumerate(tunable):
        about = t.about
        text = quoteattr(about.meaning + ("; 0 is null" if about.nullable else ""))
        what = f'causality="parameter" variability="tunable" description={text}'
        low = 0.0 if about.nullable else about.low
        more = f'{_unit(about.unit)} min="{low:.17g}" max="{about.high:.17g}"'
        rows.append(
            _row(
                version,
                about.name,
                FIRST_TUNABLE + i,
                what,
                f'{more} start="{t.start:.17g}"',
            )
        )
    head = _HEADS[version].format(
        token=token, version=__version__, step=f"{step_s:.17g}"
    )
    symbols = sorted(units - {"1"})
    named = "".join(f"<Unit name={quoteattr(u)}/>" for u in symbols)
    first = len(inputs(table)) + 2
    return (
        f"{head}<UnitDefinitions>{named}</UnitDefinitions>\n"
        f'<DefaultExperiment startTime="0" stepSize="{step_s:.17g}"/>\n'
        f"<ModelVariables>\n{''.join(rows)}</ModelVariables>\n"
        f"<ModelStructure>{_structure(version, first)}</ModelStructure>\n</fmiModelDescription>\n"
    )


_HEADS: Final = {
    3: '<?xml version="1.0" encoding="UTF-8"?>\n<fmiModelDescription fmiVersion="3.0"'
    ' modelName="robot" instantiationToken="{token}" generationTool="hilserver {version}">\n'
    '<CoSimulation modelIdentifier="robot" canGetAndSetFMUState="true" canSerializeFMUState="true"'
    ' canHandleVariableCommunicationStepSize="true" fixedInternalStepSize="{step}"/>\n',
    2: '<?xml version="1.0" encoding="UTF-8"?>\n<fmiModelDescription fmiVersion="2.0"'
    ' modelName="robot" guid="{token}" generationTool="hilserver {version}">\n'
    '<CoSimulation modelIdentifier="robot" canGetAndSetFMUstate="true" canSerializeFMUstate="true"'
    ' canHandleVariableCommunicationStepSize="true">\n'
    '<SourceFiles><File name="robot_fmu.c"/></SourceFiles></CoSimulation>\n',
}
BUILD: Final = """\
<?xml version="1.0" encoding="UTF-8"?>
<fmiBuildDescription fmiVersion="3.0">
<BuildConfiguration modelIdentifier="robot">
<SourceFileSet language="C11" compiler="gcc" compilerOptions="-ffp-contract=off">
<SourceFile name="robot_fmu.c"/>
</SourceFileSet>
<Library name="m"/>
</BuildConfiguration>
</fmiBuildDescription>
"""


def _unit(symbol: str) -> str:
    return "" if symbol == "1" else f"unit={quoteattr(symbol)}"


def _row(version: int, name: str, reference: int, what: str, more: str) -> str:
    first = f'name={quoteattr(name)} valueReference="{reference}" {what}'
    if version == 3:
        return f"<Float64 {first} {more}/>\n"
    return f"<ScalarVariable {first}><Real {more}/></ScalarVariable>\n"


def _structure(version: int, first_output: int) -> str:
    if version == 3:
        references = range(FIRST_OUTPUT, FIRST_OUTPUT + N_Y)
        lines = [
            f'<{kind} valueReference="{r}"/>'
            for kind in ("Output", "InitialUnknown")
            for r in references
        ]
        return "".join(lines)
    unknowns = "".join(f'<Unknown index="{first_output + i}"/>' for i in range(N_Y))
    return f"<Outputs>{unknowns}</Outputs><InitialUnknowns>{unknowns}</InitialUnknowns>"
