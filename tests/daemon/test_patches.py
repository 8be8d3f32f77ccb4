"""A model patch is loaded and removed while the robot runs: from one tick on, and replayable."""

import asyncio
import errno
import os

import numpy as np
import pytest
import yaml

from hilserver.commands.demo import demo_assembly
from hilserver.config.patch import load_patch
from hilserver.config.root import Config
from hilserver.core.snapshot import SnapshotStore, read_snapshot
from hilserver.daemon.assembly import assemble, assemble_config
from hilserver.daemon.builder import build
from hilserver.daemon.patches import Patches, file_of
from hilserver.errors import ConfigError, ControlRefused
from hilserver.image import Row
from hilserver.io.recorder import Recorder, Settings
from hilserver.logs import read_log
from hilserver.status import UNCERTAIN
from tests.replay.test_recordings import replay

CONFIG = Config.model_validate({"scheduler": {"backend": "virtual"}})
MADE = {"findings_sha256": "", "config_sha256": CONFIG.sha256, "version": "1"}
TURN = {"wheel.fl": 40, "wheel.rl": 40, "wheel.fr": -10, "wheel.rr": -10}
GAIN = -0.4


def write_patch(path, *, made=MADE, **terms):
    data = {"schema": "hilserver.model_patch/1", "made_from": made, "terms": terms}
    path.write_text(yaml.safe_dump(data), encoding="utf-8")


@pytest.fixture
def folder(tmp_path):
    fitted = {"turn_rate_rad_s": [-0.01, 0.01]}
    write_patch(tmp_path / "turn.yaml", rotation_gain={"value": GAIN, "unit": "1"})
    write_patch(
        tmp_path / "narrow.yaml",
        made={**MADE, "config_sha256": "of another one"},
        rotation_gain={"value": GAIN, "unit": "1", "fitted_in": fitted},
    )
    write_patch(tmp_path / "wrong.yaml", actuation_delay={"value": 99.0, "unit": "s"})
    return tmp_path


class Run:
    """A core in virtual time with a recorder, and the patches of a folder."""

    def __init__(self, core, folder):
        self.core, self.patches = core, Patches(folder, core)
        self.recorder = Recorder(core.image.name, Settings(folder / "run.mcap"))
        core.scheduler.after_batch.append(self.recorder.look)
        core.image.control.state = 1
        rows = [Row(core.table.slot(f"{n}.setpoint_rpm"), v) for n, v in TURN.items()]
        assert core.image.push(rows)

    async def turn_rate(self):
        """Half a second on: the rate that the wheels give."""
        await self.core.scheduler.advance(500)
        return self.core.image.latest().values[
            self.core.table.slot("velocity.angular_rad_s")
        ]


@pytest.fixture
async def run(folder):
    async with build(assemble_config(CONFIG, folder)) as core:
        yield Run(core, folder)


async def test_it_acts_from_its_tick_on_and_leaves_nothing_behind(run):
    rates = [await run.turn_rate()]
    await run.patches.load("turn.yaml")
    assert run.patches.loaded == "turn.yaml"
    rates.append(await run.turn_rate())
    await run.patches.remove()
    rates.append(await run.turn_rate())
    run.recorder.close()
    assert run.patches.loaded is None
    assert rates[1] == pytest.approx((1 + GAIN) * rates[0], rel=1e-3)
    assert rates[2] == pytest.approx(rates[0], rel=1e-3)
    told = [event.message for event in run.core.events.recent]
    assert told == [
        "model patch 'turn.yaml' is loaded from tick 500 on",
        "the model patch no longer applies from tick 1000 on",
    ]


async def test_a_recording_goes_on_in_its_segment_and_comes_again_to_the_bit(
    run, folder
):
    await run.turn_rate()
    await run.patches.load("turn.yaml")
    await run.turn_rate()
    await run.patches.load("narrow.yaml")
    await run.turn_rate()
    run.recorder._supervise(0.0)
    run.recorder.close()
    log = read_log(folder / "run.mcap")
    assert not log.segment.any()
    assert np.array_equal(log.ticks(1_000_000), np.arange(1500)), "no tick is missing"
    assert [(state.segment, state.tick) for state in log.states] == [(0, 0)]
    assert [(c.tick, c.number) for c in log.changes] == [(500, 1), (1000, 2)]
    assert log.changes[0].values["terms.rotation_gain"] == GAIN
    words = ("run.mcap", "-o", "again.mcap", "--check")
    said = await asyncio.to_thread(replay, *words, cwd=folder)
    assert "outputs of 1500 ticks are equal, bit for bit" in said
    assert [c.tick for c in read_log(folder / "again.mcap").changes] == [500, 1000]


async def test_a_recording_says_the_patch_it_began_with_and_comes_again_to_the_bit(
    run, folder
):
    await run.patches.load("turn.yaml")
    await run.turn_rate()
    later = Recorder(run.core.image.name, Settings(folder / "later.mcap", waits=True))
    run.core.scheduler.after_batch.append(later.look)
    await run.core.snapshots.capture()  # the state that it has asked for
    await run.turn_rate()
    await run.patches.remove()
    await run.turn_rate()
    for recorder, name, patch in (
        (run.recorder, "run", None),
        (later, "later", "turn.yaml"),
    ):
        recorder._supervise(0.0)
        recorder.close()
        said = read_log(folder / f"{name}.mcap").run["patch"]
        assert said == (patch and load_patch(folder / patch).provenance)
    said = await asyncio.to_thread(
        replay, "later.mcap", "-o", "again.mcap", "--check", cwd=folder
    )
    assert "ticks are equal, bit for bit" in said
    assert [c.tick for c in read_log(folder / "again.mcap").changes] == [1000]


async def test_where_it_was_not_fitted_outputs_are_uncertain_and_the_user_is_told(run):
    await run.patches.load("narrow.yaml")
    await run.turn_rate()
    status = run.core.image.latest().status
    assert status[run.core.table.slot("pose.x_m")] == UNCERTAIN
    assert "another configuration" in run.core.events.recent[-1].message
    run.recorder.close()


async def test_what_an_option_adds_is_no_other_configuration(folder):
    """`hilserver run --demo`: its own peer made each patch one for another robot."""
    demo = demo_assembly(assemble_config(CONFIG, folder), "opc.tcp://127.0.0.1:1/x")
    async with build(demo) as core:
        run = Run(core, folder)
        await run.patches.load("turn.yaml")
        assert run.patches.notice is None
        await run.patches.save("again")
        await run.patches.load("again.yaml")
        assert run.patches.notice is None
        await run.patches.load("narrow.yaml")
        assert "another configuration" in run.patches.notice
        run.recorder.close()


async def test_a_snapshot_brings_its_patch_and_a_reset_keeps_the_one_at_work(
    run, folder
):
    store: SnapshotStore = run.core.snapshots
    p, _ = run.core.image.region("p")
    plain = p.copy()
    await store.save("before")
    await run.patches.load("turn.yaml")
    patched = p.copy()
    assert not np.array_equal(patched, plain)
    await run.turn_rate()
    store.reset()
    await run.core.scheduler.advance(1)
    assert np.array_equal(p, patched)
    await store.load("before")
    assert np.array_equal(p, plain)
    assert run.core.parameters.differing == {}
    assert run.patches.loaded is None
    assert (
        "'turn.yaml' is not part of the loaded state"
        in run.core.events.recent[-1].message
    )
    await run.patches.load("turn.yaml")
    await store.save("after")
    await run.turn_rate()
    await store.load("after")
    assert run.patches.loaded == "turn.yaml"
    _, meta = read_snapshot(folder / "snapshots" / "after.npz")
    assert (meta["config_sha256"], meta["seed"]) == (CONFIG.sha256, 0)
    assert meta["patch"] == load_patch(folder / "turn.yaml").provenance
    for ends in (run.patches.remove, run.patches.reset):
        await ends()
        await store.save("without")
        assert read_snapshot(folder / "snapshots" / "without.npz")[1]["patch"] is None
        await run.patches.load("turn")
    run.recorder.close()


async def test_a_full_disk_leaves_no_half_of_a_patch_or_snapshot(
    run, folder, monkeypatch
):
    assert run.core.parameters.write("test", {"terms.rotation_gain": 0.1}) == {}
    with monkeypatch.context() as full:
        full.setattr("hilserver.daemon.patches.os.fsync", refuse_for_lack_of_space)
        with pytest.raises(
            ControlRefused, match=r"full\.npz: cannot be written: No space left"
        ):
            await run.core.snapshots.save("full")
        with pytest.raises(ControlRefused, match="cannot be written: No space left"):
            await run.patches.save("tuned")
    assert not [*folder.rglob("*full*"), *folder.rglob("tuned.yaml")]
    await run.patches.save("tuned")
    run.recorder.close()


def refuse_for_lack_of_space(_file):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


async def test_what_was_tuned_is_saved_as_a_patch_that_brings_it_back(run, folder):
    tuned = {
        "plant.controller.k_p": 15.0,
        "terms.rotation_gain": 0.1,
        "plant.wheelbase_m": 0.3,
    }
    with pytest.raises(ControlRefused, match="no parameter differs"):
        await run.patches.save("tuned")
    assert run.core.parameters.write("test", tuned) == {}
    await run.patches.save("tuned")
    with pytest.raises(ControlRefused, match=r"'tuned\.yaml' exists"):
        await run.patches.save("tuned")
    run.core.parameters.reset()
    assert run.core.parameters.differing == {}
    await run.patches.load("tuned")  # by the name that it was saved by
    assert run.patches.loaded == "tuned.yaml"
    assert run.core.parameters.differing == tuned
    await run.patches.load("turn.yaml")
    assert run.core.parameters.differing == {"terms.rotation_gain": GAIN}
    await run.patches.remove()
    assert run.core.parameters.differing == {}
    run.recorder.close()
    patched = assemble(None, folder / "tuned.yaml")
    assert {n: patched.composition.settings[n] for n in tuned} == tuned
    assert patched.identity == assemble(None).identity


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("drive", "drive.yaml"),
        ("drive.yml", "drive.yml"),
        ("hall", "hall.yml"),
        ("hall.v2", "hall.v2.yaml"),
        ("bare", "bare"),
    ],
)
def test_a_name_without_suffix_is_that_of_the_yaml_file(tmp_path, name, found):
    for file in (
        "drive",
        "drive.yaml",
        "drive.yml",
        "hall",
        "hall.yml",
        "hall.v2.yaml",
        "bare",
    ):
        (tmp_path / file).touch()
    assert file_of(tmp_path, name, "patch").name == found
    with pytest.raises(ControlRefused, match=r"there is no patch 'bare\.yaml'"):
        file_of(tmp_path, "bare.yaml", "patch")


@pytest.mark.parametrize(
    ("name", "error", "text"),
    [
        ("no-such.yaml", ControlRefused, "there is no patch 'no-such.yaml'"),
        ("wrong.yaml", ConfigError, r"wrong\.yaml:.*actuation_delay"),
    ],
)
async def test_what_cannot_be_loaded_changes_nothing(run, name, error, text):
    before = run.core.image.region("p")[0].copy()
    with pytest.raises(error, match=text):
        await run.patches.load(name)
    with pytest.raises(ControlRefused, match="no patch is loaded"):
        await run.patches.remove()
    assert np.array_equal(run.core.image.region("p")[0], before)
    assert not run.core.events.recent
    run.recorder.close()
