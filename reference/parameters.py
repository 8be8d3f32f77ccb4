"""The page of the parameters."""

from collections.abc import Iterable
from math import isnan

from hilserver.parameters.table import BODY, GAIN, JUMPS, PLANT, Parameter

HEAD = """# Parameters: what changes while the robot runs

Made from the code by `make reference`; a test keeps it up to date. Names
are those of [config.yaml](configuration.md), where these values are set for the start; the terms
of `plant.terms` begin with `terms.`, and a bare cause stands for its first part. Parameters of own
blocks are `blocks.<block>.<parameter>`.

A change acts at one tick, all values of one write together. It is an input of that tick: a
recording holds the packed numbers, and a replay gives the same bits. What does not fit the others
(an unstable wheel loop, a centre of rotation outside the wheels, a delay longer than its ring) is
refused with the reason, and nothing changes. States go on: the integral keeps its output when a
gain changes, filters keep what they showed, a delay that is switched on begins with the present
value, a wheel in contact stays so when play is added.

A value may have a name, which every door takes where it takes text: K_om
{names};
`plant.exclusive_twist` is `true` or `false`. `hilserver set`, the page's view Tune, ROS 2 (a
string, a bool), scenarios (`set:`) and the test kit take it as the value, OPC UA by the method
`SetParameter`, as its variables are Doubles. In an FMU every parameter is a number, and 0 is null.

*Jumps* names the outputs that may change at once in the tick of the change; all others go on
without a jump. The ranges of the set-points are those of the start.

| parameter | unit | range | default | meaning | jumps |
|---|---|---|---|---|---|
"""
TAIL = """
`mechatronic.*` can be read like the others; a change needs a restart. While the mechatronic model
runs, so do the geometry and, where `driven_by` is `torque`, the process: the body is built of them.

| jumps | outputs |
|---|---|
"""


def as_markdown() -> str:
    """Return the reference as Markdown."""
    groups = "".join(f"| {word} | {_code(names)} |\n" for word, names in JUMPS.items())
    head = HEAD.replace("{names}", PLANT[GAIN].names_text)
    return head + "".join(map(_row, PLANT.values())) + TAIL + groups


def _code(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def _row(p: Parameter) -> str:
    unit = "" if p.unit == "1" else p.unit
    default = "null" if isnan(p.default) else f"{p.default:g}"
    bounds = f"{p.low:g} .. {p.high:g}" + (", null" if p.nullable else "")
    jumps = "needs a restart" if p.name.startswith(BODY) else ", ".join(p.jumps.split())
    meaning = p.meaning.replace("|", "\\|")
    return f"| `{p.name}` | {unit} | {bounds} | {default} | {meaning} | {jumps} |\n"
