"""Run the FMU in FMPy with the inputs of a recording; print and draw how the curves compare."""

import sys
from pathlib import Path

import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi3 import FMU3Slave

from hilserver.logs import read_log

STEP_S = 0.001
SHOWN = (
    "pose.x_m",
    "pose.yaw_rad",
    "wheel.fl.speed_rpm",
    "nav.x_m",
    "imu.gyro_z_rad_s",
)


def main(fmu, recording):
    """Give every tick's inputs to the FMU and compare its outputs with those of the recording."""
    said, log = read_model_description(fmu), read_log(Path(recording))
    inputs = [
        v
        for v in said.modelVariables
        if v.causality == "input" and v.name in log.columns
    ]
    number = {v.name: v.valueReference for v in said.modelVariables}
    robot = FMU3Slave(
        guid=said.guid,
        unzipDirectory=extract(fmu),
        modelIdentifier=said.coSimulation.modelIdentifier,
        instanceName="robot",
    )
    robot.instantiate()
    robot.enterInitializationMode()
    robot.exitInitializationMode()
    given = np.array([log.columns[v.name] for v in inputs]).T
    curves = np.empty((len(log), len(SHOWN)))
    for tick, values in enumerate(given):
        robot.setFloat64([v.valueReference for v in inputs], values.tolist())
        robot.doStep(tick * STEP_S, STEP_S)
        curves[tick] = robot.getFloat64([number[name] for name in SHOWN])
    robot.terminate()
    for name, curve in zip(SHOWN, curves.T, strict=True):
        difference = np.abs(curve - log.columns[name]).max()
        print(
            f"{name:20} {curve.min():9.4f} .. {curve.max():7.4f}  largest difference {difference:g}"
        )
    draw(log.t_s, curves, log)


def draw(t_s, curves, log):
    """Draw both into curves.png, where matplotlib is installed."""
    try:
        from matplotlib import pyplot  # noqa: PLC0415
    except ImportError:
        return
    figure, plots = pyplot.subplots(len(SHOWN), sharex=True, figsize=(8, 10))
    for plot, name, curve in zip(plots, SHOWN, curves.T, strict=True):
        plot.plot(t_s, log.columns[name], linewidth=4, alpha=0.3, label="hilserver")
        plot.plot(t_s, curve, linewidth=1, label="the FMU in FMPy")
        plot.set_ylabel(name)
    plots[0].legend()
    plots[-1].set_xlabel("time [s]")
    figure.savefig("curves.png")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
