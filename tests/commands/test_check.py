"""What `hilserver check` says about a configuration that may run, and hardly does what is meant."""

import pytest

from hilserver.commands.check import describe
from hilserver.daemon.assembly import assemble

LEFT, RIGHT = "[wheel.fl.setpoint_rpm, wheel.rl.setpoint_rpm]", "wheel.fr.setpoint_rpm"


def said(folder, text):
    path = folder / "config.yaml"
    path.write_text(text, encoding="utf-8")
    return describe(assemble(path))


def warned(folder, read, more=""):
    peer = (
        f"peers:\n  - {{name: a, endpoint: 'opc.tcp://h:1', read: {{{read}}}}}\n{more}"
    )
    return [line for line in said(folder, peer) if line.startswith("warning: ")]


def test_wheels_that_no_peer_commands_are_named(tmp_path):
    [line] = warned(tmp_path, f"'ns=1;s=l': {LEFT}, 'ns=1;s=r': {RIGHT}")
    assert "no peer sets wheel.rr.setpoint_rpm: these wheels stand still" in line
    [line] = warned(tmp_path, "'ns=1;s=x': measured.nav.x_m")
    assert line.count("setpoint_rpm") == 4 + 2


@pytest.mark.parametrize(
    "read",
    [
        f"'ns=1;s=l': {LEFT}, 'ns=1;s=r': [{RIGHT}, wheel.rr.setpoint_rpm]",
        "'ns=1;s=a': wheels.setpoints_rpm",
        "'ns=1;s=v': twist.linear_m_s, 'ns=1;s=m': control.mode",
    ],
)
def test_all_wheels_commanded_is_no_warning(tmp_path, read):
    assert warned(tmp_path, read) == []


def test_a_twist_without_the_mode_has_no_effect(tmp_path):
    [line] = warned(tmp_path, "'ns=1;s=v': twist.linear_m_s")
    assert "none sets control.mode" in line


def test_wheels_are_not_the_peers_when_others_drive(tmp_path):
    text = "'ns=1;s=x': measured.nav.x_m"
    assert warned(tmp_path, text, "control: {source: opcua}\n") == []


@pytest.mark.parametrize(
    ("text", "sources"),
    [
        ("page: {enabled: false}\n", "scenario, opcua, peer"),
        ("page: {enabled: true}\n", "scenario, page, opcua, peer"),
    ],
)
def test_sources_appear_only_where_they_exist(tmp_path, text, sources):
    assert (
        f"control: 'opcua' has control at the start; sources, highest first: {sources}"
        in said(tmp_path, text)
    )
