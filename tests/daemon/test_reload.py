"""A configuration read again: what changes at once, what is named, what is refused."""

import logging
from pathlib import Path
from typing import Any

import pytest
import structlog

from hilserver.commands import running
from hilserver.commands.demo import demo_assembly, twin_assembly
from hilserver.config.patch import SCHEMA_2, ModelPatch, Patch
from hilserver.config.root import Config, load_config
from hilserver.daemon.assembly import Assembly, assemble
from hilserver.daemon.daemon import Daemon
from hilserver.daemon.reload import RELOADABLE, Reloader, changes
from hilserver.scheduler import OverrunLimits
from tests.commands.test_cli import write_config


def test_changes_are_found_key_by_key() -> None:
    before = Config()
    after = Config.model_validate(
        {"logging": {"level": "DEBUG"}, "plant": {"terms": {"rotation_gain": -0.4}}}
    )
    found = {c.key: (c.before, c.after) for c in changes(before, after)}
    assert found["logging.level"] == ("INFO", "DEBUG")
    assert found["plant.terms.rotation_gain"] == (None, -0.4)
    assert changes(before, before) == []


def test_every_reloadable_key_exists() -> None:
    keys = [c.key for c in changes(Config(), Config())] + _keys(
        Config().model_dump(mode="json")
    )
    for begin in RELOADABLE:
        assert any(key.startswith(begin) for key in keys), begin


def _keys(section: dict, prefix: str = "") -> list[str]:
    keys: list[str] = []
    for name, value in section.items():
        is_section = isinstance(value, dict) and value
        keys += _keys(value, f"{prefix}{name}.") if is_section else [f"{prefix}{name}"]
    return keys


@pytest.fixture(autouse=True)
def logging_as_before():
    yield
    structlog.reset_defaults()
    logging.basicConfig(handlers=[], force=True)


def about_reload(lines: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Without what a busy computer makes the daemon say."""
    return [line for line in lines if line["event"].startswith("reload")]


async def test_a_running_daemon_takes_what_it_can(tmp_path: Path, monkeypatch) -> None:
    path = write_config(tmp_path)
    good = path.read_text(encoding="utf-8")
    async with Daemon(assemble(path)) as daemon:
        reloader = Reloader(daemon)
        given: list[OverrunLimits] = []
        monkeypatch.setattr(daemon.scheduler, "set_limits", given.append)

        path.write_text(good + "plant: {max_rmp: 80}\n", encoding="utf-8")
        with structlog.testing.capture_logs() as said:
            assert not await reloader.reload()
        [line] = about_reload(said)
        assert "config.yaml:5: unknown key 'plant.max_rmp'" in line["reason"]
        assert daemon.desk.patches.from_file == daemon.config

        path.write_text(
            good
            + "plant: {max_rpm: 80}\n"
            + "scheduler: {limits: {consecutive_overruns: 7, single_overrun_ms: null}}\n"
            + "control: {opcua_stale_after_ms: 250.0}\n",
            encoding="utf-8",
        )
        with structlog.testing.capture_logs() as said:
            assert await reloader.reload()
        events = {line["key"]: line["event"] for line in about_reload(said)}
        assert events == {
            "control.opcua_stale_after_ms": "reload: changed",
            "plant.max_rpm": "reload: needs a restart, the old value stays",
            "scheduler.limits.consecutive_overruns": "reload: changed",
            "scheduler.limits.single_overrun_ms": "reload: changed",
        }
        assert given == [OverrunLimits(single_ns=0, consecutive=7)]
        assert daemon.gate.leases.limit_ms("opcua") == 250.0
        assert daemon.config.control.opcua_stale_after_ms == 250.0
        after = daemon.metrics.render()[0].decode()
        assert f'config="{daemon.config.sha256}"' in after, (
            "hil_build_info names what is in force"
        )
        assert daemon.config.sha256 != daemon.assembly.config.sha256

        with (
            structlog.testing.capture_logs() as said
        ):  # what waits for a restart is told again
            assert await reloader.reload()
        assert [line.get("key") for line in about_reload(said)] == ["plant.max_rpm"]


def recorded(assembly: Assembly, path: Path) -> Assembly:
    return running._recorded(assembly, path.with_name("out.mcap"))


def demonstrated(assembly: Assembly, _: Path) -> Assembly:
    return demo_assembly(assembly, "opc.tcp://127.0.0.1:1/x")


def twinned(assembly: Assembly, _: Path) -> Assembly:
    return twin_assembly(assembly, "opc.tcp://127.0.0.1:1/x")


def test_a_twin_without_a_file_has_none_for_its_diagnoses_either() -> None:
    assert twinned(assemble(None), Path()).path is None


@pytest.mark.parametrize("name", ["config.yaml", "other.yaml"])
@pytest.mark.parametrize("option", [recorded, demonstrated, twinned])
async def test_what_options_replaced_is_no_change(tmp_path, option, name) -> None:
    path = write_config(tmp_path).rename(tmp_path / name)
    reloader = Reloader(Daemon(option(assemble(path), path)))
    with structlog.testing.capture_logs() as said:
        assert await reloader.reload()
    assert [line["event"] for line in said] == [
        "reload: the configuration has not changed"
    ]
    text = path.read_text(encoding="utf-8")
    path.write_text(f"{text}recording: {{buffer_mb: 33}}\n", encoding="utf-8")
    with structlog.testing.capture_logs() as said:
        assert await reloader.reload()
    assert [line["key"] for line in said] == ["recording.buffer_mb"]


async def test_a_patch_of_the_file_that_was_read_again_is_of_this_configuration(
    tmp_path,
) -> None:
    """The hash was that of the start: each patch that was fitted after a reload warned."""
    path = write_config(tmp_path)
    daemon = Daemon(assemble(path))
    before = daemon.desk.patches.config_sha256
    path.write_text(
        f"{path.read_text(encoding='utf-8')}control: {{opcua_stale_after_ms: 250.0}}\n"
    )
    assert await Reloader(daemon).reload()
    fitted = {"schema": SCHEMA_2, "made_from": {"config_sha256": "", "version": "1"}}
    for sha256, is_other in ((load_config(path).sha256, False), (before, True)):
        fitted["made_from"]["config_sha256"] = sha256
        patch = Patch(ModelPatch.model_validate(fitted))
        assert bool(patch.notice(daemon.desk.patches.config_sha256)) is is_other


def test_only_limits_of_its_own_stop_a_demonstration(tmp_path) -> None:
    path = write_config(tmp_path)
    assert (
        demonstrated(assemble(path), path).config.scheduler.limits.single_overrun_ms
        is None
    )
    stricter = "scheduler: {limits: {single_overrun_ms: 20.0}}\n"
    path = write_config(tmp_path, stricter)
    assert (
        demonstrated(assemble(path), path).config.scheduler.limits.single_overrun_ms
        == 20.0
    )
