"""What cannot run as an FMU is refused at the start: one sentence with file, line and remedy."""

import re
import tempfile
import zipfile

import pytest

from hilserver.commands import main
from hilserver.daemon.builder import build
from hilserver.errors import ConfigError
from hilserver.fmu.description import PLATFORM
from tests.fmu.rig import configured, description, make

CLOCK = '<Clock name="tick" valueReference="20" causality="input" intervalVariability="triggered"/>'
EXCHANGE = "ModelExchange"


def refused(folder, fmu, **more):
    with pytest.raises(ConfigError) as caught:
        build(configured(folder, {"name": "motor", "fmu": fmu} | more)).close()
    text = str(caught.value)
    assert re.match(rf"{folder}/config.yaml:\d+: blocks\[0\]\.", text), text
    assert "\n" not in text
    return text


def test_what_is_no_fmu(tmp_path):
    (tmp_path / "text.fmu").write_text("this is none")
    with zipfile.ZipFile(tmp_path / "empty.fmu", "w") as packed:
        packed.writestr("readme.txt", "nothing")
    for name, words in {
        "text.fmu": "is not a zip file",
        "empty.fmu": "has no modelDescription.xml",
        "absent.fmu": "does not exist: there is no file",
    }.items():
        assert words in refused(tmp_path, name)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<fmi", "has an invalid modelDescription.xml"),
        (description(3).replace('"3.0"', '"4.0"'), "Unsupported FMI version: 4.0"),
        (description(3, variables=CLOCK), "has clocks, which need event mode"),
        (description(3, interface=EXCHANGE), "offers no co-simulation"),
        (
            description(3).replace(
                'modelIdentifier="model"', 'modelIdentifier="../libm"'
            ),
            f"has no binaries/{PLATFORM}/../libm.so, which its description names",
        ),
        (
            description(3).replace(
                "<CoSimulation ", '<CoSimulation needsExecutionTool="true" '
            ),
            "runs only with the tool that made it",
        ),
    ],
)
def test_what_it_says_of_itself_does_not_fit(tmp_path, text, words):
    make(tmp_path / "lag.fmu", 3, text=text)
    assert words in refused(tmp_path, "lag.fmu")


@pytest.mark.parametrize(
    ("name", "size", "words"),
    [
        (
            "../../etc/passwd",
            1,
            "has a path that leaves the archive, '../../etc/passwd'",
        ),
        ("/etc/passwd", 1, "cannot be unpacked: Illegal path /etc/passwd"),
        ("resources/zeros", 1 << 30, "unpacks to more than 1 GB"),
        (
            "modelDescription.xml",
            (1 << 26) + 1,
            "has a modelDescription.xml of more than 64 MB",
        ),
    ],
)
def test_what_it_packs_is_looked_at_before_anything_is_unpacked(
    fmus, tmp_path, monkeypatch, name, size, words
):
    unpacked = tmp_path / "unpacked"
    unpacked.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(unpacked))
    with zipfile.ZipFile(fmus / "lag3.fmu") as lag:
        entries = {entry: lag.read(entry) for entry in lag.namelist()}
    with zipfile.ZipFile(
        tmp_path / "lag.fmu", "w", zipfile.ZIP_DEFLATED, compresslevel=1
    ) as packed:
        for entry, content in entries.items():
            if entry != name:
                packed.writestr(entry, content)
        with packed.open(name, "w") as entry:
            for _ in range(size >> 20):
                entry.write(bytes(1 << 20))
            entry.write(bytes(size % (1 << 20)))
    assert words in refused(tmp_path, "lag.fmu")
    assert not any(unpacked.iterdir())


def test_a_thousand_tunable_parameters_are_said_to_be_too_many(tmp_path, capsys):
    rows = "".join(
        f'<Float64 name="p{i}" valueReference="{i}" causality="parameter" variability="tunable"'
        ' start="1"/>'
        for i in range(100, 1100)
    )
    make(tmp_path / "lag.fmu", 3, text=description(3, variables=rows))
    start = {"p900": 2}
    assembly = configured(tmp_path, {"name": "motor", "fmu": "lag.fmu", "start": start})
    (block,) = assembly.composition.blocks
    assert next(iter(block.declaration.parameters.items())) == ("p900", 2.0)
    assert main(["check", "-c", str(tmp_path / "config.yaml")]) == 0
    said = capsys.readouterr().out
    assert "745 tunable parameters beyond the first 256 keep their values" in said


def test_an_array_of_a_billion_is_too_long_before_anybody_counts_it(tmp_path):
    text = description(3).replace(
        '<Dimension start="2"/>', '<Dimension start="1000000000"/>'
    )
    make(tmp_path / "lag.fmu", 3, text=text)
    words = refused(tmp_path, "lag.fmu", inputs={"v[1]": "sim.tick"})
    assert "'v' of lag.fmu has 1000000000 values; at most 256 are possible" in words


def test_another_platform_is_named(tmp_path):
    make(tmp_path / "lag.fmu", 2, folder="win64")
    text = refused(tmp_path, "lag.fmu")
    assert "only for win64; export it for this computer" in text


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("process", [False, True], ids=["here", "beside"])
def test_a_missing_function_is_named(tmp_path, version, process):
    make(tmp_path / "lag.fmu", version, "-DLACKS_STEP")
    assert f"lacks the function fmi{version}DoStep" in refused(
        tmp_path, "lag.fmu", process=process
    )
    make(tmp_path / "lag.fmu", version, "-DSTATELESS")
    text = refused(tmp_path, "lag.fmu", process=process)
    assert "lacks the function" in text
    assert "state" in text.lower()


@pytest.mark.parametrize("process", [False, True], ids=["here", "beside"])
def test_a_token_that_is_not_the_librarys_is_named(tmp_path, process):
    make(tmp_path / "lag.fmu", 3, text=description(3).replace("{lag}", "{other}"))
    text = refused(tmp_path, "lag.fmu", process=process)
    assert "FMU 'motor' (lag.fmu) does not start: wrong token." in text


@pytest.mark.parametrize("process", [False, True], ids=["here", "beside"])
def test_what_it_says_when_it_does_not_start(fmus, tmp_path, process):
    lag = str(fmus / "lag3.fmu")
    text = refused(tmp_path, lag, start={"lag": -1}, process=process)
    assert "FMU 'motor' (lag3.fmu) does not start: lag must be positive." in text


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (
            {"inputs": {"uu": "sim.tick"}},
            "has no variable 'uu'; known are u, y, Gain, lag",
        ),
        ({"outputs": {"gain": "k"}}, "did you mean 'Gain'?"),
        ({"inputs": {"y": "sim.tick"}}, "'y' of lag3.fmu is output, not input"),
        ({"inputs": {"v[1]": "sim.tick"}}, "input 'v[2]' of lag3.fmu is not wired"),
        ({"inputs": {"u": "sim.tock"}}, "there is no scalar signal 'sim.tock'"),
        ({"start": {"y": 1}}, "'y' of lag3.fmu takes no start value: it is output"),
        ({"start": {"Gain": "much"}}, "'Gain' of lag3.fmu takes a number, not 'much'"),
        ({"outputs": {"y": "a", "sum": "a"}}, "two outputs would be 'a'"),
        ({"slice": "fast"}, "there is no plant-side slice 'fast'"),
    ],
)
def test_wiring_that_does_not_fit(fmus, tmp_path, more, words):
    assert words in refused(tmp_path, str(fmus / "lag3.fmu"), **more)


@pytest.mark.parametrize(
    ("block", "words"),
    [
        ({"name": "motor"}, "name either a function or an fmu"),
        ({"fmu": "a.fmu", "function": "a:b"}, "name either a function or an fmu"),
        ({"name": "a", "function": "a:b", "process": True}, "'process' is for an fmu"),
        ({"fmu": "a.fmu", "parameters": {"a": 1}}, "an fmu takes 'start'"),
        ({"fmu": "a.fmu", "outputs": {"a": "b.c"}}, "outputs"),
    ],
)
def test_keys_that_do_not_go_together(tmp_path, block, words):
    with pytest.raises(ConfigError, match=words):
        configured(tmp_path, block)


def test_it_has_the_name_of_its_file(fmus, tmp_path):
    (tmp_path / "rear-axle 2.fmu").symlink_to(fmus / "lag3.fmu")
    assembly = configured(tmp_path, {"fmu": "rear-axle 2.fmu"})
    assert "rear_axle_2.y" in assembly.table
