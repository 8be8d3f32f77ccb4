"""Two hundred wrong configurations, each with its sentence; what is right is let through."""

import sys
from pathlib import Path

import pytest

from hilserver.commands import _parse, check, running
from hilserver.commands.announcing import Announcer
from hilserver.commands.validation import validate
from hilserver.daemon.assembly import assemble
from hilserver.daemon.soundness import doubts
from hilserver.errors import EXIT_BAD_CONFIGURATION, ConfigError
from hilserver.program.writer import Writer
from tests.commands.test_cli import hilserver

HERE = Path(__file__).parent
EXAMPLES = sorted((HERE.parents[1] / "examples").glob("*/config.yaml"))


def wrong():
    """Pairs of a configuration and what is said of it; a line of the list has ``\\n`` within."""
    lines = (HERE / "wrong.txt").read_text(encoding="utf-8").splitlines()
    texts, sentences = lines[::3], lines[1::3]
    return [
        (text.replace("\\n", "\n"), sentence)
        for text, sentence in zip(texts, sentences, strict=True)
    ]


def right():
    lines = (HERE / "right.txt").read_text(encoding="utf-8").splitlines()
    return [line.replace("\\n", "\n") for line in lines]


def refusal(act):
    with pytest.raises(ConfigError) as caught:
        act()
    assert caught.value.exit_code == EXIT_BAD_CONFIGURATION == 78
    return str(caught.value)


def test_check_and_run_refuse_the_same_with_the_same_sentence(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(running, "setup_logging", lambda *_: None)
    announcer = Announcer(Writer(sys.stderr), "json")
    cases = wrong()
    assert len(cases) >= 200
    ask = _parse(["check", "-c", "config.yaml"])
    start = _parse(["run", "-c", "config.yaml"])
    different = []
    for text, sentence in cases:
        Path("config.yaml").write_text(text + "\n", encoding="utf-8")
        try:
            told = refusal(lambda: check.run(ask))
            if sentence not in told.replace(f"{tmp_path}/", "") or "\n" in told:
                different.append((text, sentence, told))
            if refusal(lambda: running.serve(start, None, announcer)) != told:
                different.append((text, told, "run says something else"))
        except pytest.fail.Exception:
            different.append((text, sentence, "nothing"))
    assert different == []


def test_what_is_right_is_let_through(tmp_path):
    path, refused = tmp_path / "config.yaml", []
    for text in right():
        path.write_text(text + "\n", encoding="utf-8")
        try:
            validate(assemble(path))
        except ConfigError as error:
            refused.append((text, str(error)))
    assert refused == []
    assert len(right()) >= 50


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.parent.name)
def test_the_examples_are_right_without_a_doubt(path):
    assembly = assemble(path)
    validate(assembly)
    assert doubts(assembly) == []


@pytest.mark.parametrize(
    ("text", "doubt"),
    [
        (
            "plant: {max_rpm: 500}",
            "plant.max_rpm: 500 rpm are never reached: 100 % duty",
        ),
        (
            "plant: {controller: {k_i: 0}}",
            "plant.controller.k_i: 0 leaves the wheels below",
        ),
        (
            "scheduler: {slices: {fast: 1}}",
            "scheduler.slices.fast: nothing runs in this",
        ),
        (
            "recording: {keep: 3}",
            "recording.keep: has no effect without recording.rotate_mb",
        ),
        (
            "observer: {enabled: true}",
            "observer.source: sensors.nav is off, so the estimate",
        ),
        (
            "control: {command_timeout_ms: 40}\npeers: [{name: a, endpoint: 'opc.tcp://h:1',"
            " read: {'ns=1;s=x': wheel.fl.setpoint_rpm}}]",
            "peers[0].publishing_ms: values come every 50 ms, and control.command_timeout_ms",
        ),
        (
            "peers: [{name: a, endpoint: 'opc.tcp://h:1', read: {'ns=1;s=x': ["
            "wheel.fl.setpoint_rpm, wheel.rl.setpoint_rpm, wheel.fr.setpoint_rpm,"
            " wheel.rr.setpoint_rpm]}}]",
            "peers[0].read: 'ns=1;s=x' sets all four wheels, so the robot only turns on the",
        ),
    ],
)
def test_what_is_only_doubtful_is_a_warning(tmp_path, text, doubt):
    path = tmp_path / "config.yaml"
    path.write_text(text + "\n", encoding="utf-8")
    assembly = assemble(path)
    validate(assembly)
    [said] = doubts(assembly)
    assert said.startswith(doubt)


def test_a_name_that_no_file_can_have_here(tmp_path, monkeypatch):
    path = tmp_path / "config.yaml"
    text = "recording: {file: größe.mcap}\nfolders: {reports: prüfung}\n"
    path.write_text(text, encoding="utf-8")
    assembly = assemble(path)
    validate(assembly)
    monkeypatch.setattr(sys, "getfilesystemencoding", lambda: "ascii")
    first, second = refusal(lambda: validate(assembly)).splitlines()
    assert ":1: recording.file: file names are ascii here and cannot have 'ö'" in first
    assert ":2: folders.reports: " in second


@pytest.mark.long
def test_ten_of_them_by_the_commands_themselves(tmp_path):
    for text, sentence in wrong()[::28]:
        (tmp_path / "config.yaml").write_text(text + "\n", encoding="utf-8")
        ends = [
            hilserver(name, "-c", "config.yaml", cwd=tmp_path)
            for name in ("check", "run")
        ]
        for end in ends:
            assert end.returncode == EXIT_BAD_CONFIGURATION, text
            assert sentence in end.stderr.replace(f"{tmp_path}/", "")
            assert "Traceback" not in end.stderr
