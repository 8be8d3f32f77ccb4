"""Builds the FMU of `model.c`, and robots that have it as a block."""

import subprocess
import zipfile
from pathlib import Path

import yaml

from hilserver.daemon.assembly import assemble
from hilserver.fmu.description import PLATFORM

SOURCE = Path(__file__).with_name("model.c")
FOLDER = {2: "linux64" if PLATFORM == "x86_64-linux" else PLATFORM, 3: PLATFORM}
_CAN = {2: ("canGetAndSetFMUstate", "canSerializeFMUstate")}
_CAN[3] = tuple(name.replace("FMUstate", "FMUState") for name in _CAN[2])
_OLD = {"Float64": "Real", "Int32": "Integer", "Boolean": "Boolean"}
VARIABLES = [
    ("Float64", "u", 1, 'causality="input"', 'start="0"'),
    ("Float64", "y", 2, 'causality="output"', 'unit="N.m" min="-1000" max="1000"'),
    ("Float64", "Gain", 3, 'causality="parameter" variability="tunable"', 'start="2"'),
    ("Float64", "lag", 4, 'causality="parameter" variability="fixed"', 'start="0.1"'),
    ("Int32", "mischief", 5, 'causality="parameter" variability="fixed"', 'start="0"'),
    ("Int32", "atStep", 6, 'causality="parameter" variability="fixed"', 'start="100"'),
    ("Boolean", "positive", 7, 'causality="output" variability="discrete"', ""),
    ("Int32", "steps", 8, 'causality="output" variability="discrete"', ""),
]
_ONLY_3 = """
<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
<Float64 name="v" valueReference="9" causality="input" start="3 3"><Dimension start="2"/></Float64>
<Float64 name="sum" valueReference="10" causality="output"/>
<Float32 name="small" valueReference="11" causality="input" start="0"/>
"""


def description(version, *, state=True, variables="", interface="CoSimulation"):
    """Return a modelDescription.xml."""
    can = " ".join(f'{name}="{str(state).lower()}"' for name in _CAN[version])
    unit = '<UnitDefinitions><Unit name="N.m"/></UnitDefinitions>'
    kind = f'<{interface} modelIdentifier="model" {can}/>{unit}'
    if version == 3:
        rows = "".join(
            f'<{t} name="{n}" valueReference="{r}" {c} {more}/>'
            for t, n, r, c, more in VARIABLES
        )
        return (
            '<fmiModelDescription fmiVersion="3.0" modelName="lag" instantiationToken="{lag}">'
            f"{kind}<ModelVariables>{rows}{_ONLY_3}{variables}</ModelVariables><ModelStructure>"
            '<Output valueReference="2"/><Output valueReference="7"/><Output valueReference="8"/>'
            '<Output valueReference="10"/><InitialUnknown valueReference="2"/></ModelStructure>'
            "</fmiModelDescription>"
        )
    rows = "".join(
        f'<ScalarVariable name="{n}" valueReference="{r}" {c}><{_OLD[t]} {more}/></ScalarVariable>'
        for t, n, r, c, more in VARIABLES
    )
    unknowns = "".join(f'<Unknown index="{i}"/>' for i in (2, 7, 8))
    return (
        '<fmiModelDescription fmiVersion="2.0" modelName="lag" guid="{lag}">'
        f"{kind}<ModelVariables>{rows}</ModelVariables><ModelStructure><Outputs>{unknowns}</Outputs>"
        f"<InitialUnknowns>{unknowns}</InitialUnknowns></ModelStructure></fmiModelDescription>"
    )


def make(path, version=3, *flags, text=None, folder=None, state=True):
    """Compile the FMU `path`."""
    library = path.with_suffix(".so")
    command = ["gcc", "-shared", "-fPIC", "-O1", f"-DFMI={version}", *flags, "-w"]
    subprocess.run([*command, "-o", library, SOURCE], check=True)
    with zipfile.ZipFile(path, "w") as packed:
        packed.writestr(
            "modelDescription.xml", text or description(version, state=state)
        )
        packed.write(library, f"binaries/{folder or FOLDER[version]}/model.so")
    return path


def configured(folder, *blocks, **sections):
    """Return the assembly of a configuration with blocks."""
    path = folder / "config.yaml"
    path.write_text(yaml.safe_dump({"blocks": list(blocks)} | sections))
    return assemble(path)
