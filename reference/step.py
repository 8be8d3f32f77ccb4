"""The page that shows one generated step."""

import tempfile
from pathlib import Path

from hilserver.daemon.assembly import Assembly, assemble
from hilserver.image.layout import make_layout
from hilserver.kernel.source import step_source

_BLOCK = """\
from hilserver.plant.blocks import Output, block


@block(inputs=("duty_pct",), outputs=(Output("force_n", unit="N"),))
def load_cell(dt_s, u, y, x, p):
    y[0] = 0.4 * u[0]
"""

_CONFIGURATION = """\
blocks:
  - name: load_cell
    function: load_cell.py:load_cell
    slice: sensors
    inputs: {duty_pct: wheel.fl.duty_pct}
"""

_PAGE = """\
# The step

Made from the code by `make reference`; a test keeps it up to date.

In every tick the pacing back end calls one compiled function, the step. Everything it does is a
named function in a file; only the list of calls is generated, because compiled code cannot loop
over functions. So a set-point can be followed from file to file:

| phase | function | what happens to the set-point |
|---|---|---|
| before the tick | `InputGate.write` in `core/inputs.py` | checked, pushed into a queue |
| `LATCH` | `latch` in `kernel/phases.py` | serves snapshots, then: |
| | `latch_rows` in `image/queues.py` | taken from the queue into the working frame |
| | `modify_inputs` in `kernel/modifiers.py` | changed by injected faults and forces |
| plant slice | `robot` in `kernel/parts.py`, `robot_step` in `plant/robot.py` | one tick: |
| | `command` in `plant/command.py` | enabled, limited, delayed: what the wheel loops follow |
| | `drive_base` in `plant/drive.py` | controller, motor, wheel: it becomes a speed |
| | `velocity_base` in `plant/kinematics.py`, `move` in `plant/pose.py` | and a change of the pose |
| sensor slice | `imu`, `battery`, `shield`, `tof`, `nav` in `kernel/parts.py` | they show it |
| `PUBLISH` | `publish` in `kernel/phases.py` | stamps the frame, then: |
| | `modify_outputs` in `kernel/modifiers.py` | changed by injected faults and forces |
| | `publish_frame` in `image/ring.py` | the frame is in the ring, for everybody to read |
| `FAULT` | `enter_safe` in `kernel/phases.py` | replaced by the ramp of the safe state |

With terms of the plant switched on, `drive_terms` and `velocity_terms` of the same files run
instead of the base model.

`AT` says where the robot's parameters `p`, state `x`, inputs `u`, outputs `y` and status codes `q`
begin in the [process image](../decisions/0003-inputs-are-queues-of-rows.md), and the slots of a few
signals. Beside that, two configurations differ only in which parts and [own
blocks](../how-to/own-block.md) stand in which slice.

## The default configuration

```python
{default}```

## With a block

A load cell like that of [Add your own block to the plant](../how-to/own-block.md) in the sensor
slice adds the slots of its signals and these lines:

```python
{block}```

The steps that a machine has compiled lie in the cache folder (`$XDG_CACHE_HOME/hilserver` or
`~/.cache/hilserver`), named `step_<hash>.py`.
"""


def _source(assembly: Assembly) -> str:
    composition = assembly.composition
    layout = make_layout(
        composition.table.n_slots,
        ring_length=1,
        queue_rows=1,
        live=composition.live_regions,
        fixed=composition.fixed_regions,
    )
    return step_source(composition, layout)


def _block_lines() -> str:
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "load_cell.py").write_text(_BLOCK, encoding="utf-8")
        path = Path(folder) / "config.yaml"
        path.write_text(_CONFIGURATION, encoding="utf-8")
        lines = _source(assemble(path)).splitlines(keepends=True)
    slots = [line for line in lines if line.startswith(("INPUTS_", "OUTPUTS_"))]
    first = next(i for i, line in enumerate(lines) if "fault = 0" in line)
    return "".join(
        [*slots, "\n", *lines[first : lines.index("        return fault\n") + 1]]
    )


def as_markdown() -> str:
    """Return the whole page."""
    return _PAGE.format(default=_source(assemble(None)), block=_block_lines())
