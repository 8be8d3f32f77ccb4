"""The variables of the robot's FMU: signals by their names, parameters that can be tuned."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isnan
from typing import Final
from xml.sax.saxutils import quoteattr

import numpy as np

from hilserver import __version__
from hilserver.parameters import PLANT, Parameter, read, with_values
from hilserver.plant.errors import PlantError
from hilserver.plant.layout import Inputs, Outputs, Parameters
from hilserver.plant.packing import initial_state, pack
from hilserver.plant.parameters import RobotParameters
from hilserver.signals import Signal, SignalTable

FLAGS: Final = ("command_terms", "drive_terms", "kinematic_terms")
"""Numbers of the packed parameters that say whether any term of a kind is on."""
N_U, N_Y = Inputs.n_words, Outputs.n_words
FIRST_INPUT, FIRST_OUTPUT, FIRST_TUNABLE = 1, 1000, 2000  # value references; the time has 0


@dataclass(frozen=True)
class Tunable:
    """A parameter that is one number of the packed ones, as it stands."""

    about: Parameter
    place: int  # of the number
    start: float  # what the robot has
    flag: int  # which of `FLAGS` is 1 while it is not null; -1: none


def inputs(table: SignalTable) -> list[Signal]:
    """Return the inputs in the order of `u`, the daemon's hidden ones included."""
    return sorted((s for s in table.scalars if s.slots[0] < N_U), key=lambda s: s.slots[0])


def outputs(table: SignalTable) -> list[Signal]:
    """Return the outputs in the order of `y`."""
    found = (s for s in table.scalars if N_U <= s.slots[0] < N_U + N_Y)
    return sorted(found, key=lambda s: s.slots[0])


def tunables(robot: RobotParameters) -> list[Tunable]:
    """Return the parameters that the FMU can take over without packing the robot anew.

    Whether one can is found out by packing the robot with both ends of its range: exactly one
    number has to change, and to become the value itself. The rest would need checks and constants
    that are computed when the FMU is made.
    """
    values = read(robot)
    found: dict[int, Tunable] = {}
    for name, value in values.items():
        tunable = _tunable(robot, PLANT[name], value)
        if tunable is not None:
            found.setdefault(tunable.place, tunable)  # two that add up to one number: the first
    seed = Parameter("seed", "1", 0, 2.0**53 - 1, 0, nullable=False, meaning="seed of all noise")
    place = Parameters.where("seed").start
    return [*found.values(), Tunable(seed, place, float(robot.seed), -1)]


def _tunable(robot: RobotParameters, about: Parameter, start: float) -> Tunable | None:
    if about.nullable or isnan(start) or about.when != "tick":
        return None
    now, flags = pack(robot).numbers, [Parameters.where(name).start for name in FLAGS]
    places: set[int] = set()
    switched: set[int] = set()
    for value in (about.low, 0.5 * (about.low + about.high), about.high):
        try:
            other = with_values(robot, {about.name: value})
            then = pack(other).numbers
        except (PlantError, OverflowError, ValueError):
            return None
        if (
            other.loop != robot.loop
            or (initial_state(other).numbers != initial_state(robot).numbers).any()
        ):
            return None
        changed = set(np.flatnonzero(now != then).tolist())
        switched |= changed & set(flags)
        places |= changed - set(flags)
        if len(places) > 1 or any(then[place] != value for place in places):
            return None
    if len(places) != 1 or len(switched) > 1:
        return None
    flag = flags.index(switched.pop()) if switched else -1
    return Tunable(about, places.pop(), start, flag)


def flags_without(robot: RobotParameters, tunable: Sequence[Tunable]) -> list[bool]:
    """Return each of `FLAGS` as the terms have it that cannot be tuned."""
    null = {t.about.name: t.about.default for t in tunable if t.flag >= 0}
    bare = pack(with_values(robot, null)).numbers
    return [bool(bare[Parameters.where(name).start]) for name in FLAGS]


def description(
    version: int, table: SignalTable, tunable: Sequence[Tunable], step_s: float, token: str
) -> str:
    """Return the modelDescription.xml of FMI 2.0 or 3.0."""
    rows: list[str] = []
    units = {s.unit for s in (*inputs(table), *outputs(table))} | {t.about.unit for t in tunable}
    rows.append(_row(version, "time", 0, 'causality="independent" variability="continuous"', ""))
    for i, s in enumerate(inputs(table)):
        what = f'causality="input" variability="discrete" description={quoteattr(s.description)}'
        more = f'{_unit(s.unit)} min="{s.low:.17g}" max="{s.high:.17g}" start="{s.initial:.17g}"'
        rows.append(_row(version, s.name, FIRST_INPUT + i, what, more))
    for i, s in enumerate(outputs(table)):
        what = f'causality="output" variability="discrete" description={quoteattr(s.description)}'
        rows.append(_row(version, s.name, FIRST_OUTPUT + i, what, _unit(s.unit)))
    for i, t in enumerate(tunable):
        about = t.about
        text = quoteattr(about.meaning)
        what = f'causality="parameter" variability="tunable" description={text}'
        more = f'{_unit(about.unit)} min="{about.low:.17g}" max="{about.high:.17g}"'
        rows.append(
            _row(version, about.name, FIRST_TUNABLE + i, what, f'{more} start="{t.start:.17g}"')
        )
    head = _HEADS[version].format(token=token, version=__version__, step=f"{step_s:.17g}")
    named = "".join(f"<Unit name={quoteattr(u)}/>" for u in sorted(units - {"1"}))
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
