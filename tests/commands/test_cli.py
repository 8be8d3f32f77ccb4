"""The command line as a user in a hurry meets it: exit codes, one sentence, no traceback."""

import argparse
import errno
import gc
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hilserver import commands
from hilserver.commands import COMMANDS, main
from hilserver.image.shared_file import SharedFile
from tests.helpers.daemons import free_port


def hilserver(*words, cwd, timeout=600):
    return subprocess.run(
        [sys.executable, "-m", "hilserver", *words],
        capture_output=True,
        text=True,
        timeout=timeout,
        cwd=cwd,
        check=False,
    )


@pytest.fixture
def here(tmp_path, monkeypatch, capsys):
    """`hilserver` in this process and an empty folder; returns exit code, stdout and stderr."""
    monkeypatch.chdir(tmp_path)

    def run(*words):
        try:
            code = main(words)
        except SystemExit as end:  # of argparse
            code = end.code
        return code, *capsys.readouterr()

    return run


def write_config(folder, text=""):
    ports = f"opcua: {{endpoint: 'opc.tcp://127.0.0.1:{free_port()}/h'}}\nmetrics: {{port: 0}}\n"
    path = folder / "config.yaml"
    text = f"image: {{name: auto}}\n{ports}{text}page: {{enabled: false}}\n"
    path.write_text(text, encoding="utf-8")
    return path


def test_every_module_with_a_command_is_listed():
    files = Path(commands.__file__).parent.glob("*.py")
    modules = [
        f.stem for f in files if "\ndef add_arguments(" in f.read_text(encoding="utf-8")
    ]
    assert {name.replace("_", "-") for name in modules} == set(COMMANDS)


@pytest.mark.parametrize("command", [*COMMANDS, ""])
def test_help_of_every_command_has_an_example(command, here):
    code, out, _ = here(*[command] * bool(command), "--help")
    assert code == 0
    assert "example: hilserver" in out


@pytest.mark.parametrize("command", ["bench", "certs", "identify", "scenarios"])
def test_help_of_every_action_has_an_example(command, monkeypatch):
    added = argparse._SubParsersAction.add_parser
    made = []
    monkeypatch.setattr(
        argparse._SubParsersAction,
        "add_parser",
        lambda self, *words, **options: (
            made.append(added(self, *words, **options)) or made[-1]
        ),
    )
    commands._module(command).add_arguments(argparse.ArgumentParser())
    helps = [action.format_help() for action in made if action.add_help]
    assert len(helps) > 2
    assert all(f"example: hilserver {command} " in text for text in helps)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (
            "plant: {max_rmp: 90}\n",
            "config.yaml:4: unknown key 'plant.max_rmp'; did you mean",
        ),
        (
            "plant: {max_rpm: fast}\n",
            "config.yaml:4: plant.max_rpm: 'fast' is not valid",
        ),
        (
            "scheduler:\n  slices: {supervise: 100.5}\n",
            "config.yaml:5: scheduler.slices.supervise: ",
        ),
        (
            "scheduler:\n  slices: {plant: 15}\n",
            "config.yaml:5: scheduler.slices.plant: slice 'plant' has 15 ms",
        ),
        ("sensors:\n  imu: {slice: fast}\n", "there is no plant-side slice 'fast'"),
        (
            "blocks:\n  - {name: a, function: 'absent.py:f'}\n",
            "config.yaml:5: blocks[0].function: ",
        ),
        (
            "peers:\n  - name: a\n    endpoint: opc.tcp://127.0.0.1:1/\n"
            "    read: {'ns=1;s=a': wheel.fl.setpoint}\n",
            "config.yaml:7: peers[0].read.ns=1;s=a: there is no signal 'wheel.fl.setpoint'",
        ),
    ],
)
def test_a_bad_configuration_is_one_sentence_and_exit_78(
    tmp_path, monkeypatch, capsys, text, complaint
):
    write_config(tmp_path, text)
    monkeypatch.chdir(tmp_path)
    for command in ("check", "run"):
        assert main([command]) == 78
        printed = capsys.readouterr().err
        assert complaint in printed
        assert len(printed.splitlines()) == 1


def test_check_refuses_a_unit_that_the_server_cannot_show(
    tmp_path, monkeypatch, capsys
):
    (tmp_path / "own.py").write_text(
        "from hilserver.plant.blocks import Output, block\n\n"
        "@block(inputs=(), outputs=(Output('far', unit='parsec', low=0.0, high=1.0),))\n"
        "def away(dt_s, u, y, x, p):\n    y[0] = 0.0\n"
    )
    write_config(
        tmp_path, "blocks:\n  - {name: a, function: 'own.py:away', slice: sensors}\n"
    )
    monkeypatch.chdir(tmp_path)
    assert main(["check"]) == 78
    printed = capsys.readouterr().err
    assert "config.yaml:4: blocks: unit 'parsec' is unknown; write one of" in printed
    assert len(printed.splitlines()) == 1


def test_check_says_what_the_configuration_means(tmp_path):
    run = hilserver("check", "-c", str(write_config(tmp_path)), cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    assert "K_om 1.955 1/m" in run.stdout
    assert "slice plant: every 1 ms" in run.stdout


def test_run_ends_after_its_duration_with_0(tmp_path):
    run = hilserver(
        "run", "-c", str(write_config(tmp_path)), "--duration", "0.5", cwd=tmp_path
    )
    assert run.returncode == 0, run.stderr
    assert "Traceback" not in run.stderr


# SIGTERM also ends every daemon of `tests.helpers.daemons`, whose exit code is looked at.
@pytest.mark.parametrize(
    "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.long)]
)
def test_signals_end_the_daemon_cleanly(tmp_path, number):
    command = [
        sys.executable,
        "-m",
        "hilserver",
        "run",
        "-c",
        str(write_config(tmp_path)),
    ]
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, cwd=tmp_path
    ) as process:
        lines = []
        for line in process.stderr:
            lines.append(line)
            if "hilserver is running" in line:
                break
        time.sleep(0.2)
        os.kill(process.pid, number)
        rest = process.stderr.read()
        assert process.wait(600) == 0, rest
    assert "Traceback" not in "".join(lines) + rest


def handles(process, number):
    """Whether the process has taken a signal over from the interpreter and the system."""
    status = Path(f"/proc/{process.pid}/status").read_text(encoding="utf-8")
    caught = int(re.search(r"SigCgt:\s*(\w+)", status).group(1), 16)
    return bool(caught >> (number - 1) & 1)


@pytest.mark.parametrize(
    ("number", "after_s"),
    [
        (signal.SIGTERM, 0.0),
        (signal.SIGTERM, 0.4),
        (signal.SIGINT, 1.0),
        # test_ending sends each signal while kernels are being compiled.
        pytest.param(signal.SIGTERM, 1.0, marks=pytest.mark.long),
        pytest.param(signal.SIGINT, 3.0, marks=pytest.mark.long),
    ],
)
def test_signals_end_a_start_cleanly(tmp_path, number, after_s):
    """Cold: modules are imported, then kernels are being compiled when the signal comes."""
    path = write_config(tmp_path)
    environment = {**os.environ, "HILSERVER_CACHE_DIR": str(tmp_path / "cache")}
    command = [sys.executable, "-m", "hilserver", "run", "-c", str(path), "--demo"]
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, cwd=tmp_path, env=environment
    ) as process:
        while not handles(process, signal.SIGTERM):
            assert process.poll() is None
        maps = Path(f"/proc/{process.pid}/maps").read_text(encoding="utf-8")
        assert "numba" not in maps, "what takes long to import comes after"
        time.sleep(after_s)
        os.kill(process.pid, number)
        told = process.stderr.read()
        assert process.wait(600) == 0, told
    events = [json.loads(line)["event"] for line in told.splitlines()]
    assert all(event.startswith("hilserver ") for event in events)
    ended = "hilserver has stopped while it was starting, exit code 0"
    assert not events or events[-1] == ended, "without a line: it came before the first"


@pytest.mark.parametrize(
    "words", [["-c", "none.yaml"], ["--scenario-schema", "schema.json"]]
)
def test_a_run_that_ends_early_leaves_the_garbage_collector_on(words, here):
    here("run", *words)
    assert gc.isenabled()


def test_a_signal_while_the_step_is_compiled_ends_it_at_once(monkeypatch):
    """numba turns an interrupt within its callbacks into an error of its own."""

    def broken(_words):
        os.kill(os.getpid(), signal.SIGTERM)
        raise RuntimeError("no compiled object yet")

    monkeypatch.setattr("hilserver.commands._parse", broken)
    before = signal.getsignal(signal.SIGTERM)
    assert main(["run"]) == 0
    assert signal.getsignal(signal.SIGTERM) is before


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("diagnose", "hilserver: stopped while starting; nothing was done\n"),
        ("convert", "hilserver: stopped while starting; nothing was done\n"),
        ("run", ""),
    ],
)
def test_a_signal_while_a_command_is_imported_is_a_sentence(
    monkeypatch, capsys, command, said
):
    """Importing compiles, which takes a minute; `run` has its own words, in the form of its log."""

    def interrupted(_name):
        os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr("hilserver.commands.importlib.import_module", interrupted)
    assert main([command, "a.csv", "-o", "out"]) == 0
    assert capsys.readouterr().err == said


def test_an_interrupt_within_python_run_from_c_is_no_end_by_signal(tmp_path):
    """The interpreter ends itself by SIGINT when a KeyboardInterrupt came that way."""
    lines = [
        "import ctypes, os, signal, sys",
        "import hilserver.commands as commands",
        "def run(_):",
        "    code = b'import os, signal; os.kill(os.getpid(), signal.SIGTERM)'",
        "    return ctypes.pythonapi.PyRun_SimpleString(code)",
        "commands._parse = run",
        "sys.exit(commands.main(['run']))",
    ]
    (tmp_path / "interrupted.py").write_text("\n".join(lines), encoding="utf-8")
    run = subprocess.run(
        [sys.executable, "-m", "interrupted"], cwd=tmp_path, check=False
    )
    assert run.returncode == 0


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (
            ("check", "--schema", "absent/schema.json"),
            "absent/schema.json: no such file",
        ),
        (
            ("latency-test", "--duration", "0.1", "--json", "."),
            ".: is a directory; name a file",
        ),
        (("check", "--schema", "/dev/full"), "/dev/full: no space left; free some"),
        (("signals", "-o", "/dev/full"), "/dev/full: no space left; free some"),
        (
            ("model", "--format", "urdf", "-o", "/dev/full"),
            "/dev/full: no space left; free some",
        ),
        (
            ("run", "--scenario-schema", "/dev/full"),
            "/dev/full: no space left; free some",
        ),
    ],
)
def test_a_file_that_cannot_be_written_is_one_sentence(here, words, complaint):
    code, _, said = here(*words)
    assert code == 1
    assert said.startswith(f"hilserver: cannot write {complaint}")
    assert len(said.splitlines()) == 1


@pytest.mark.parametrize(
    ("word", "hint"), [("diagnosis", "did you mean 'diagnose'?"), ("rnu", "see --help")]
)
def test_a_command_that_does_not_exist_is_one_sentence(here, word, hint):
    code, out, said = here(word, "-o", "x")
    assert (code, out) == (2, "")
    assert (
        said.splitlines()[-1]
        == f"hilserver: error: there is no command '{word}'; {hint}"
    )


def test_a_figure_file_is_tried_before_the_measurement(here, monkeypatch):
    monkeypatch.setattr(
        "hilserver.bench.loop.run", lambda _: pytest.fail("it was measured")
    )
    code, out, said = here("bench", "loop", "--json", "absent/x.json")
    assert code == 1
    assert "absent/x.json: no such file" in said
    assert out == ""


@pytest.mark.parametrize(("where", "code"), [(">/dev/full", 1), (">&-", 0)])
def test_output_that_nobody_takes_is_no_traceback(tmp_path, where, code):
    command = f"{sys.executable} -m hilserver signals {where}"
    run = subprocess.run(
        command, shell=True, capture_output=True, text=True, cwd=tmp_path, check=False
    )
    assert run.returncode == code
    assert "Traceback" not in run.stderr


@pytest.mark.parametrize("duration", ["0", "-1", "abc", "nan", "1e400"])
def test_a_wrong_duration_is_named(here, duration):
    code, _, said = here("run", "--duration", duration)
    assert code == 2
    assert f"argument --duration: {duration} is not a duration in seconds" in said


def test_a_page_on_another_port_than_its_own_says_why_and_is_an_event(tmp_path):
    path = write_config(tmp_path)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        page = f"page: {{port: {port}}}"
        path.write_text(path.read_text().replace("page: {enabled: false}", page))
        run = hilserver("run", "-c", str(path), "--duration", "0.2", cwd=tmp_path)
    lines = [json.loads(line) for line in run.stderr.splitlines()]
    [where] = [line for line in lines if line["event"] == "operator page"]
    events = [line for line in lines if where["why"] in line["event"]]
    assert f"port {port} (page.port) is in use" in where["why"]
    assert f":{port}/" not in where["url"]
    assert len(events) == 1


def test_a_port_in_use_is_one_sentence_and_exit_1(tmp_path):
    path = write_config(tmp_path)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        text = path.read_text().replace(
            "metrics: {port: 0}", f"metrics: {{port: {port}}}"
        )
        path.write_text(text)
        run = hilserver("run", "-c", str(path), cwd=tmp_path)
    assert run.returncode == 1
    assert f"port {port}" in run.stderr
    assert "Traceback" not in run.stderr


def test_two_daemons_with_one_image_name(tmp_path):
    path = write_config(tmp_path)
    name = f"test-cli-{os.getpid()}"
    path.write_text(path.read_text().replace("name: auto", f"name: {name}"))
    command = [sys.executable, "-m", "hilserver", "run", "-c", str(path)]
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, cwd=tmp_path
    ) as first:
        for line in first.stderr:
            if "hilserver is running" in line:
                break
        second = hilserver("run", "-c", str(path), cwd=tmp_path)
        typo = tmp_path / "typo.yaml"
        typo.write_text(f"image: {{name: {name}}}\nplant: {{wheel_radius: 0.1}}\n")
        mistaken = hilserver("run", "-c", str(typo), cwd=tmp_path)
        first.send_signal(signal.SIGTERM)
        first.stderr.read()
        assert first.wait(600) == 0
    assert second.returncode == 1
    assert f"another hilserver uses the process image '{name}'" in second.stderr
    # before, the other one was blamed
    assert "unknown key 'plant.wheel_radius'" in mistaken.stderr
    assert mistaken.returncode == 78


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["run", "my.yaml"], "write '-c my.yaml'"),
        (["check", "my.yaml"], "write '-c my.yaml'"),
        (["convert", "a.csv", "-o", "b.mcap"], "convert does not take '-o'"),
        (["signals", "my.yaml", "--quick"], "write '-c my.yaml'"),
        (["run", "-c", "a.yaml", "my.yaml"], "unrecognized arguments: my.yaml"),
        (["diagnose", "a.csv", "-o", "out", "b.csv"], "unrecognized arguments: b.csv"),
        (["diagnose", "a.csv", "-o", "out", "c.yaml"], "write '-c c.yaml'"),
        (["call", "Stop", "--quick"], "call does not take '--quick'"),
    ],
)
def test_a_word_too_many_is_named_with_the_usage_of_its_command(here, words, hint):
    code, _, said = here(*words)
    assert code == 2
    assert said.startswith(f"usage: hilserver {words[0]} ")
    assert said.splitlines()[-1].endswith(hint)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("replay a.csv -o b.csv --between 1 2", "--between says what --require judges"),
        ("replay a.csv -o a.csv", "a.csv: is the log itself"),
        ("replay a.csv -o b.txt", "must end in .mcap or .csv"),
        ("simulate a.csv -o b.csv --duration 1", "--duration is for a scenario"),
        ("simulate a.csv -o b.csv --require r.yaml", "--require needs a scenario"),
        ("simulate drive.yaml -o b", "must end in .mcap or .csv"),
        ("sweep --dry-run", "name a sweep"),
        ("sweep sweep.yaml", "name a folder for the results"),
        ("experiment --measured m.yaml", "name its experiment, too"),
        ("certs make --days 0", "--days: "),
        ("record -o a.csv --keep 2", "--keep counts the files of a rotation"),
        ("record -o a --format bag --rotate-s 9", "a bag is one folder"),
        ("convert a.csv b.txt", "end the name in"),
        ("observe a.csv -o a.csv", "is the log itself"),
        ("run --record a.txt", "must end in .mcap or .csv"),
    ],
)
def test_options_that_never_go_together_are_a_mistake_of_the_command_line(
    here, tmp_path, words, complaint
):
    """Not what a script takes for a drive that has not met its requirements."""
    (tmp_path / "a.csv").write_text("t_s,sim.tick\n0,0\n", encoding="utf-8")
    code, _, said = here(*words.split())
    assert complaint in said
    assert code == 2


@pytest.mark.parametrize("words", [["record", "-o", "a.csv"], ["page"]])
def test_a_made_up_image_is_to_be_named_from_those_in_use(here, tmp_path, words):
    write_config(tmp_path)
    image = SharedFile(f"auto-{os.getpid()}-cli", 4096)
    code, _, said = here(*words)
    image.close()
    assert code == 2
    assert "image.name is 'auto': name the process image with --image" in said
    assert f"auto-{os.getpid()}-cli" in said


@pytest.mark.parametrize(
    "words",
    [["check", "--schema"], ["signals", "-o"], ["fmu", "--platforms", "none", "-o"]],
)
def test_a_full_disk_leaves_the_file_of_before(here, tmp_path, monkeypatch, words):
    def fill(place, *_, **__):
        with place.open("wb") as file:
            file.write(b"half")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_text", fill)
    monkeypatch.setattr("hilserver.fmu.export.zipfile.ZipFile", fill)
    monkeypatch.setattr("hilserver.fmu.export._sources", lambda *_: [])
    (tmp_path / "out").write_bytes(b"good")
    code, _, said = here(*words, "out")
    assert code == 1
    assert said == "hilserver: cannot write out: no space left; free some\n"
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [
        ("out", b"good")
    ]


def test_a_full_disk_elsewhere_is_not_laid_to_the_fmu(here, monkeypatch):
    def fill(folder, *_):
        raise OSError(errno.ENOSPC, "No space left on device", str(folder / "robot.h"))

    monkeypatch.setattr("hilserver.fmu.export._sources", fill)
    code, _, said = here("fmu", "--platforms", "none", "-o", "robot.fmu")
    assert code == 1
    assert said.endswith("/sources/robot.h: no space left on device\n")
