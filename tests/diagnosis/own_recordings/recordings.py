"""Recordings of the daemon: how it drove, how it was recorded, and what became of the rows."""

import asyncio
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import yaml

from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.diagnosis.engine import diagnose
from hilserver.faults.scenario import Play, Scenario
from hilserver.logs import open_writer, read_log
from hilserver.logs.csv_writer import meta_path
from hilserver.logs.provenance import make_run
from hilserver.measured.frames import Sampling
from hilserver.measured.reading import read_measured
from hilserver.replay.simulation import Simulation
from tests.fakes import image_name

QUIET = {"white_noise_m": 0.0, "correlated_noise_m": 0.0, "yaw_noise_rad": 0.0}
NOISY = {"correlated_noise_m": 0.05, "yaw_noise_rad": 0.015}
ALL_WHEELS = "wheels.setpoints_rpm"


@dataclass(frozen=True)
class Rows:
    """Which rows are left of a recording.

    Attributes
    ----------
    every : int
        Ticks from one row to the next.
    first : int
        Tick of the first row: later than 0 the recorder came to a drive under way.
    nav_empty : bool
        Navigation empty between its samples; held otherwise.
    whole : bool
        The file of the recorder itself; else a table of the rows, without origin.
    """

    every: int = 1
    first: int = 0
    nav_empty: bool = False
    whole: bool = False


def configuration(
    *, noisy: bool, seed: int = 0, terms: Mapping[str, float] | None = None
) -> Config:
    """Return a robot with navigation, its sensors with or without noise."""
    nav = {"enabled": True} | (NOISY if noisy else QUIET)
    imu = {"gyro_noise_rad_s": 0.006 if noisy else 0.0}
    plant = {"seed": seed, "terms": dict(terms or {})}
    return Config.model_validate({"sensors": {"nav": nav, "imu": imu}, "plant": plant})


def wheels(v: float, w: float) -> dict[str, object]:
    """Set all wheels: forward by v and turning by w [rpm]."""
    return {"control.mode": 0, ALL_WHEELS: [v + w, v + w, w - v, w - v]}


def twist(v: float, w: float) -> dict[str, object]:
    """Set the body: v [m/s], w [rad/s]."""
    return {"control.mode": 1, "twist.linear_m_s": v, "twist.angular_rad_s": w}


def steps(
    seconds: float, seed: int, write=wheels, size=(55.0, 25.0), ms=(400, 2000)
) -> Scenario:
    """Return set-points that jump at any tick, each piece driven back the way it came."""
    rng = np.random.default_rng(seed)
    at_ms, found = 500, []
    while at_ms < 1e3 * seconds:
        v, w = (
            size * rng.uniform(-1.0, 1.0, 2) * rng.choice([(1, 0.2), (1, 1), (0.1, 1)])
        )
        for sign in (1.0, -1.0):
            found.append({"at_s": at_ms * 1e-3, "write": write(sign * v, sign * w)})
            lasts_ms = int(rng.integers(*ms))
            at_ms += lasts_ms
    return Scenario.model_validate({"steps": found})


def curve(seconds: float, seed: int, write=twist, size=(0.35, 0.7)) -> Scenario:
    """Return set-points as of a controller: new ones every 38 to 56 ms, an eight."""
    rng = np.random.default_rng(seed)
    at_ms, found = 500, []
    while at_ms < 1e3 * seconds:
        phase = 2.0 * np.pi * at_ms / 17_000.0
        v, w = size[0] * (0.8 + 0.2 * np.sin(0.7 * phase)), size[1] * np.sin(phase)
        found.append({"at_s": at_ms * 1e-3, "write": write(float(v), float(w))})
        at_ms += int(rng.integers(38, 57))
    return Scenario.model_validate({"steps": found})


DRIVES = {
    "wheels": steps,
    "twist": lambda s, seed: steps(s, seed, twist, (0.5, 1.0)),
    "wheel curve": lambda s, seed: curve(s, seed, wheels, (35.0, 14.0)),
    "twist curve": curve,
    "long": lambda s, seed: steps(s, seed, wheels, (60.0, 30.0), (800, 4000)),
    "bench": lambda s, seed: steps(s, seed, wheels, (80.0, 8.0), (300, 1200)),
}


@dataclass(frozen=True)
class Drive:
    """A drive of the daemon in virtual time."""

    drive: str
    seconds: float
    seed: int = 0
    noisy: bool = True
    terms: Mapping[str, float] = field(default_factory=dict)

    def record(self, path):
        """Write every tick into a file of the recorder's."""
        config = configuration(noisy=self.noisy, seed=self.seed, terms=self.terms)
        play = Play(DRIVES[self.drive](self.seconds, self.seed))
        asyncio.run(
            _record(path, assemble_config(config), play, round(1e3 * self.seconds))
        )
        return path


@dataclass(frozen=True)
class RealDrive:
    """A drive of the running daemon, at the pace of the clock; no drive: its own demonstration."""

    drive: str | None
    seconds: float
    seed: int = 0
    noisy: bool = True

    def record(self, path):
        """Record from the first tick to the last."""
        config = configuration(noisy=self.noisy, seed=self.seed)
        text = yaml.safe_dump(
            config.model_dump(mode="json", include={"sensors", "plant"})
        )
        words = ["--duration", str(self.seconds), "--record", path.name]
        if self.drive is None:
            words.append("--demo")
        else:
            play = DRIVES[self.drive](self.seconds, self.seed)
            plan = yaml.safe_dump(play.model_dump(mode="json", exclude_unset=True))
            (path.parent / "scenario.yaml").write_text(plan, encoding="utf-8")
            words += ["--scenario", "scenario.yaml"]
        free = "opcua: {endpoint: 'opc.tcp://127.0.0.1:0/h'}\nmetrics: {port: 0}\n"
        image = f"image: {{name: {image_name()}}}\npage: {{enabled: false}}\n"
        (path.parent / "config.yaml").write_text(free + image + text, encoding="utf-8")
        command = [
            sys.executable,
            "-m",
            "hilserver",
            "run",
            "-c",
            "config.yaml",
            *words,
        ]
        done = subprocess.run(
            command, cwd=path.parent, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return path


async def _record(path, assembly, play, n_ticks):
    async with Simulation(assembly, play) as simulation:
        run = make_run(simulation.image.description)
        writer = open_writer(path, run, range(simulation.table.n_slots))
        writer.add_state(simulation.start)
        async for batch in simulation.frames(n_ticks):
            writer.write(batch)
        writer.close()


def thinned(source, path, rows: Rows):
    """Write some rows of a recording as a plain table."""
    log = read_log(source)
    columns = {"t_s": log.t_s, **log.columns}
    kept = {
        name: values[rows.first :: rows.every].copy()
        for name, values in columns.items()
    }
    if rows.nav_empty:
        for name in (name for name in kept if name.startswith("nav.")):
            kept[name][np.diff(kept[name], prepend=np.nan) == 0.0] = np.nan
    lines = [
        ",".join("" if v != v else repr(v) for v in row)
        for row in np.stack(list(kept.values()), axis=1).tolist()
    ]
    path.write_text("\n".join([",".join(kept), *lines]) + "\n", encoding="utf-8")
    return path


def read(source, folder, rows: Rows):
    """Read what is left of a recording as `hilserver diagnose` does."""
    sampling = Sampling.of(configuration(noisy=True))
    if rows.whole:
        return read_measured([source], None, sampling)
    table = thinned(
        source, folder / f"{source.stem}-{rows.every}-{rows.first}.csv", rows
    )
    assert not meta_path(table).exists()
    return read_measured([table], None, sampling)


def found_in(log):
    """Diagnose what was read with the configuration of the recording."""
    return diagnose(log, assemble_config(configuration(noisy=True))).findings
