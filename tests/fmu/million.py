"""FMPy through the inputs of a drive: FMU ROWS N OUTPUTS; then a thousand robots in this process.

ROWS holds step, value reference and value as doubles; the outputs of every step go to OUTPUTS.
"""

import resource
import sys
import time
from pathlib import Path

import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi3 import FMU3Slave

STEP_S, INSTANCES, STEPS = 0.001, 1000, 200


def main(path, rows, n, outputs):
    said = read_model_description(path)
    shown = [v.valueReference for v in said.modelVariables if v.causality == "output"]
    folder = extract(path)

    def begun():
        fmu = FMU3Slave(
            guid=said.guid,
            unzipDirectory=folder,
            modelIdentifier="robot",
            instanceName="r",
        )
        fmu.instantiate()
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        return fmu

    given = np.fromfile(rows).reshape(-1, 3)
    driven(begun(), given, shown, int(n)).tofile(outputs)
    used, start = resident_kb(), time.perf_counter()
    robots = [begun() for _ in range(INSTANCES)]
    first, *others = (driven(robot, given, shown, STEPS).tobytes() for robot in robots)
    assert set(others) == {first}
    took_s = time.perf_counter() - start
    more = resident_kb() - used
    print(
        f"{INSTANCES} robots, {STEPS} steps each: {took_s:.1f} s, {more / INSTANCES:.0f} kB each"
    )


def resident_kb():
    """Memory of this process that is in use."""
    return (
        int(Path("/proc/self/statm").read_text().split()[1])
        * resource.getpagesize()
        // 1024
    )


def driven(fmu, rows, shown, n):
    """Outputs of all steps; in the middle it goes on from a state that it has packed itself."""
    found, row, middle = np.empty((n, len(shown))), 0, n // 2
    for step in range(n):
        if step == middle:
            bytes_ = fmu.serializeFMUState(fmu.getFMUState())
            fmu.doStep(step * STEP_S, 100 * STEP_S)
            fmu.setFMUState(fmu.deserializeFMUState(bytes_))
        while row < len(rows) and rows[row, 0] <= step:
            fmu.setFloat64([int(rows[row, 1])], [rows[row, 2]])
            row += 1
        fmu.doStep(step * STEP_S, STEP_S)
        found[step] = fmu.getFloat64(shown)
    return found


if __name__ == "__main__":
    main(*sys.argv[1:])
