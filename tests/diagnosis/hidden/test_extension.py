"""What a diagnosis has fitted to one log makes the daemon right about another one.

The daemon (virtual time) is driven by the set-points of a log that took no part in the diagnosis,
with and without the patch, and measured in the same way: free runs that start at the measured pose.
"""

import asyncio
import re
from dataclasses import replace

import numpy as np
import pytest
from hilserver_injector import Recorder, make
from hilserver_injector.recipe import WHEELS

from hilserver.commands import main
from hilserver.daemon.assembly import assemble
from hilserver.daemon.daemon import Daemon
from hilserver.daemon.figures import model_gap
from hilserver.diagnosis.output import documents, write
from hilserver.testing.hil import Hil
from tests.diagnosis.hidden.logs import diagnosis, recipe
from tests.loopback.rig import scrape

SETPOINTS = [f"wheel.{wheel}.setpoint_rpm" for wheel in WHEELS]
NAV = ("nav.x_m", "nav.y_m", "nav.yaw_rad")
POSE = ("pose.x_m", "pose.y_m", "pose.yaw_rad")
HIDDEN = ("rotation_gain", 1, 120.0)  # 3 %
SECONDS, HORIZON_S = 125.0, 5.0
CONFIG = """\
scheduler: {backend: virtual, limits: {single_overrun_ms: null, consecutive_overruns: null},
  communication_timeout_ms: 0}
opcua: {enabled: false}
metrics: {port: 0}
control: {source: scenario}
image: {name: auto}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A configuration and the patch that the diagnosis of the first log has written."""
    made = tmp_path_factory.mktemp("extension")
    (made / "config.yaml").write_text(CONFIG, encoding="utf-8")
    write(made, documents(diagnosis(*HIDDEN)))
    return made


@pytest.fixture(scope="module")
def other():
    """A log of the same machine on another day."""
    value = recipe(*HIDDEN).causes
    made = replace(recipe("nothing drive", 77, SECONDS), causes=value)
    return make(replace(made, recorder=Recorder(missing=0.0)))[0]


async def driven(folder, table, patch=None, seconds=SECONDS):
    """Drive the daemon with the set-points of a log, the measured pose beside it in shadow mode.

    Every `HORIZON_S` the gap that `hil_model_gap` shows is noted, and the pose aligned anew. The
    last one is read from the page of metrics, too.

    Returns
    -------
    gaps : ndarray, shape (windows, 3)
        NaN: outside what the patch was fitted in the pose is Uncertain, and no gap is shown.
    poses : ndarray, shape (ticks, 3)
    """
    daemon = Daemon(assemble(folder / "config.yaml", patch), paused=True)
    hil, gaps, shown, last, aligned_s = Hil(daemon, "virtual"), [], None, 0, None
    measured = np.stack([table.columns[name] for name in NAV], axis=1)
    async with hil.running(), hil.capture(*POSE) as trace:
        for k, t_s in enumerate(table.t_s[table.t_s < seconds].tolist()):
            now = [float(table.columns[name][k]) for name in SETPOINTS]
            is_due = aligned_s is None or t_s - aligned_s >= HORIZON_S
            aligns = is_due and np.isfinite(measured[k]).all()
            if now == shown and not aligns:
                continue

            if (tick := round(t_s * 1e3)) > last:
                await hil.step(tick - last)
                last = tick
            if now != shown:
                hil.write(dict(zip(SETPOINTS, now, strict=True)))
                shown = now
            if aligns:
                there = measured[k].tolist()
                hil.write(
                    {f"measured.{n}": v for n, v in zip(POSE, there, strict=True)}
                )
                await hil.step(1)
                last += 1
                if aligned_s is not None:
                    gap = model_gap(daemon.gate, daemon.table, daemon.image.latest())
                    gaps.append([gap.get(n, np.nan) for n in POSE])
                daemon.control.set_pose(*there)
                aligned_s = t_s
        await hil.step(1)
        page = await on_the_page(daemon, "hil_model_gap")
        gap = model_gap(daemon.gate, daemon.table, daemon.image.latest())
        assert page == pytest.approx(gap)
        poses = np.stack([trace[name].values for name in POSE], axis=1)
    return np.array(gaps), poses


async def on_the_page(daemon, metric):
    """Values of a metric by channel, as Prometheus would scrape them."""
    await asyncio.sleep(1.2)  # the gap is watched once a second
    rows = re.findall(
        rf'^{metric}{{channel="(.+?)"}} (\S+)$', await scrape(daemon), re.M
    )
    return {channel: float(value) for channel, value in rows}


def ratio_of(before, after, rng):
    """Ratio of the mean errors and its bootstrap interval over the windows."""
    picks = rng.integers(0, len(before), size=(2000, len(before)))
    ratios = before[picks].mean(axis=1) / after[picks].mean(axis=1)
    return before.mean() / after.mean(), np.quantile(ratios, [0.025, 0.975])


async def test_the_gap_on_another_log_shrinks_by_the_ratio_that_was_told(folder, other):
    before, _ = await driven(folder, other)
    after, _ = await driven(folder, other, folder / "model_patch.yaml")
    shown = np.isfinite(before).all(axis=1) & np.isfinite(after).all(axis=1)
    assert shown.sum() >= 12
    before, after = before[shown], after[shown]
    told = diagnosis(*HIDDEN).findings.total_gain
    errors = {
        "yaw_rad": [np.abs(gaps[:, 2]) for gaps in (before, after)],
        "position_m": [np.hypot(gaps[:, 0], gaps[:, 1]) for gaps in (before, after)],
    }
    for quantity, (first, second) in errors.items():
        gain = told[quantity]
        assert gain.horizon_s == pytest.approx(HORIZON_S, abs=0.1)
        ratio, (low, high) = ratio_of(first, second, np.random.default_rng(0))
        print(quantity, ratio, (low, high), gain)
        assert gain.ci95[0] <= high, quantity
        assert low <= gain.ci95[1], quantity
    ratio, _ = ratio_of(*errors["yaw_rad"], np.random.default_rng(0))
    low, high = told["yaw_rad"].ci95
    assert low <= ratio <= high
    assert low > 1.0


async def test_without_the_patch_the_outputs_are_the_old_ones_bit_for_bit(
    folder, other
):
    first, old = await driven(folder, other, seconds=12.0)
    _, extended = await driven(folder, other, folder / "model_patch.yaml", seconds=12.0)
    second, again = await driven(folder, other, seconds=12.0)
    assert old.tobytes() == again.tobytes()
    assert first.tobytes() == second.tobytes()
    assert old.shape == extended.shape
    assert old.tobytes() != extended.tobytes()


def test_run_takes_the_patch(folder, monkeypatch, capfd):
    monkeypatch.chdir(folder)
    words = [
        "run",
        "-c",
        "config.yaml",
        "--patch",
        "model_patch.yaml",
        "--duration",
        "0.2",
    ]
    assert main(words) == 0
    assert "another configuration" in capfd.readouterr().err, (
        "it was fitted without a file"
    )
