"""`hilserver diagnose`: its options, files and exit codes. The engine is tested in its own room."""

import contextlib
import os
import signal

import pytest

from hilserver.commands import main
from hilserver.diagnosis import pipeline
from hilserver.diagnosis.catalogue.library import pose_candidates
from hilserver.diagnosis.power.attempts import AttemptOutcome
from hilserver.diagnosis.schema.evidence import Diagnosis
from hilserver.diagnosis.schema.findings import Detectable
from hilserver.errors import LogError
from hilserver.measured.data import LogSource, MeasuredLog
from hilserver.program.progress import Progress
from tests.diagnosis.sample import evidence, findings, nothing_found


class Names(list):
    """Stands for a log: the names of its files."""

    def noticed(self, *_lines):
        return self


@pytest.fixture
def stages(monkeypatch, tmp_path):
    """Stand-ins for reading and judging; notes what they were asked."""
    asked = []

    def read(paths, mapping, sampling):
        assert sampling is not None
        asked.append(("read", [p.name for p in paths], mapping))
        if any(p.name == "bad.csv" for p in paths):
            raise LogError("bad.csv:3: column 't_s': not a number; fix the row")
        return Names(p.name for p in paths)

    def judge(log, assembly, *, seed, jobs, progress, test=None):
        asked.append(("judge", log, seed, assembly.config.sha256))
        if progress:
            progress("screen", 0.5)
        return Diagnosis(
            findings() if log[0] != "null.csv" else nothing_found(), evidence(300)
        )

    def compare(log, other, assembly, **options):
        asked.append(("compare", log, other))
        return Diagnosis(findings(verdict="no_difference", findings=()))

    monkeypatch.setattr(pipeline, "read_measured", read)
    monkeypatch.setattr(pipeline, "diagnose", judge)
    monkeypatch.setattr(pipeline, "compare", compare)
    monkeypatch.setattr(pipeline, "machine", lambda log, robot: robot)
    monkeypatch.setattr(pipeline, "foretold", lambda *_: "It shows the drive.")
    monkeypatch.chdir(tmp_path)
    return asked


def test_several_logs_are_one_machine(stages, tmp_path, capsys):
    assert main(["diagnose", "a.csv", "b.csv", "--seed", "7", "-o", "out"]) == 0
    assert stages[0] == ("read", ["a.csv", "b.csv"], None)
    assert stages[1][1:3] == (["a.csv", "b.csv"], 7)
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        "findings.json", "report.html", "model_patch.yaml",
    }  # fmt: skip
    said = capsys.readouterr()
    assert "turns 47" in said.out
    assert "The report is out/report.html" in said.out
    # no bar where there is no terminal
    assert said.err == "It shows the drive.\n", "before it is judged"


def test_a_bad_log_is_one_sentence_exit_2_and_no_file(stages, tmp_path, capsys):
    assert main(["diagnose", "bad.csv", "-o", "out"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line == "hilserver: bad.csv:3: column 't_s': not a number; fix the row"
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_at_once_with_a_sentence_and_no_file(
    stages, tmp_path, monkeypatch, capsys, number
):
    monkeypatch.setattr(
        pipeline, "diagnose", lambda *_, **__: os.kill(os.getpid(), number)
    )
    assert main(["diagnose", "a.csv", "-o", "out"]) == 0
    *_, line = capsys.readouterr().err.splitlines()
    assert (
        line
        == "hilserver: stopped before the diagnosis was finished: no report was written"
    )
    assert not (tmp_path / "out").exists()


def test_a_signal_that_a_compiler_turns_into_an_error_of_its_own_is_a_sentence_too(
    stages, tmp_path, monkeypatch, capsys
):
    def broken(*_, **__):
        with contextlib.suppress(SystemExit):
            os.kill(os.getpid(), signal.SIGTERM)
        raise RuntimeError("no compiled object yet")

    monkeypatch.setattr(pipeline, "diagnose", broken)
    assert main(["diagnose", "a.csv", "-o", "out"]) == 0
    *_, line = capsys.readouterr().err.splitlines()
    assert (
        line
        == "hilserver: stopped before the diagnosis was finished: no report was written"
    )


def test_a_signal_among_many_logs_keeps_the_reports_so_far(
    stages, tmp_path, monkeypatch, capsys
):
    def outcomes(_function, tasks, _args):
        yield 0, pipeline.run(tasks[0])
        os.kill(os.getpid(), signal.SIGINT)
        yield 1, pipeline.run(tasks[1])

    monkeypatch.setattr("hilserver.commands.diagnose._spread", outcomes)
    assert main(["diagnose", "--each", "a.csv", "b.csv", "-o", "out"]) == 0
    told = capsys.readouterr().err.splitlines()[-1]
    assert told == "hilserver: stopped after 1 of 2 logs; their reports are kept"
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["a"]


def test_where_there_is_no_terminal_progress_is_plain_lines(monkeypatch, capsys):
    now = [0.0]
    monkeypatch.setattr("hilserver.program.progress.time.monotonic", lambda: now[0])
    progress = Progress(lambda: "")
    for second in range(12):
        now[0] = float(second)
        progress("screen", second / 12)
    assert capsys.readouterr().err.splitlines() == [" 17% screen", " 58% screen"]


def test_each_log_gets_its_folder_and_a_bad_one_stops_nobody(stages, tmp_path, capsys):
    (tmp_path / "x").mkdir()
    words = ["null.csv", "bad.csv", "x/null.csv", "--each", "--jobs", "1", "-o", "out"]
    assert main(["diagnose", *words]) == 2
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"null", "null-2"}
    said = capsys.readouterr()
    assert said.out.splitlines() == ["null: nothing_found", "null-2: nothing_found"]
    assert "bad.csv:3" in said.err


def test_two_sets_are_compared(stages, capsys):
    words = ["--compare", "a.csv", "b.csv", "--against", "c.csv", "-o", "out"]
    assert main(["diagnose", *words]) == 0
    assert stages[-1] == ("compare", ["a.csv", "b.csv"], ["c.csv"])
    assert "do not differ" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["-o", "out"], "name at least one log"),
        (["--compare", "a.csv", "-o", "out"], "belong together"),
        (
            ["a.csv", "--compare", "a.csv", "--against", "b.csv", "-o", "o"],
            "cannot be combined with other logs",
        ),
        (["a.csv", "--dask", "tcp://h:1", "-o", "out"], "use it with --each"),
        (["a.csv", "--try", "--each", "-o", "out"], "--try cannot be combined"),
        (["a.csv", "--try", "--marks", "m.yaml", "-o", "out"], "--try cannot be"),
        (["a.csv", "--causes", "body_lag", "-o", "out"], "use it with --try"),
        (["a.csv", "--minutes", "5", "-o", "out"], "use it with --try"),
        (["--group", "a=a.csv", "-o", "out"], "name two or more"),
        (
            ["--group", "a=a.csv", "--group", "a=b.csv", "-o", "out"],
            "--group a is given twice",
        ),
        (
            ["--group", "a=a.csv", "--group", "b=b.csv", "c.csv", "-o", "o"],
            "cannot be combined",
        ),
        (["a.csv", "--marks", "m.yaml", "--each", "-o", "o"], "--marks cannot be"),
        (
            ["a.csv", "--marks", "m.yaml", "--test", "b.csv", "-o", "o"],
            "--marks cannot be",
        ),
        (
            ["--marks", "m", "--compare", "a.csv", "--against", "b.csv", "-o", "o"],
            "--marks cannot be",
        ),
        (
            ["--marks", "m", "--group", "a=a.csv", "--group", "b=b.csv", "-o", "o"],
            "--marks cannot be",
        ),
    ],
)
def test_options_that_do_not_fit_are_a_sentence(
    stages, tmp_path, capsys, words, complaint
):
    assert main(["diagnose", *words]) == 2
    assert complaint in capsys.readouterr().err


def test_a_file_in_the_place_of_the_folder_is_a_sentence(stages, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["diagnose", "a.csv", "-o", "file"]) == 1
    assert "file: is a file" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--causes", "wheel_radios"], "did you mean 'wheel_radius'?"),
        (["--minutes", "soon"], "soon is no time"),
    ],
)
def test_what_cannot_be_tried_is_a_sentence(stages, capsys, words, complaint):
    with pytest.raises(SystemExit):
        main(["diagnose", "a.csv", "--try", *words, "-o", "out"])
    assert complaint in capsys.readouterr().err
    assert not stages


@pytest.mark.parametrize("text", ["a.csv", "=a.csv", "a=", "two words=a.csv"])
def test_what_is_no_group_is_a_sentence(stages, capsys, text):
    with pytest.raises(SystemExit):
        main(["diagnose", "--group", text, "-o", "out"])
    assert "is not a group" in capsys.readouterr().err


def test_groups_reach_the_engine(stages, tmp_path, monkeypatch, capsys):
    asked = []

    def judge(logs, assembly, **options):
        asked.append(logs)
        return Diagnosis(findings(), evidence(300))

    def read(paths, mapping, sampling):
        return MeasuredLog(tuple(LogSource(p.name, p.stem) for p in paths), {}, ())

    monkeypatch.setattr(pipeline, "diagnose_groups", judge)
    monkeypatch.setattr(pipeline, "read_measured", read)
    groups = ["--group", "asphalt=a.csv,b.csv", "--group", "sand=s.csv"]
    assert main(["diagnose", *groups, "-o", "out"]) == 0
    files = {name: [s.file for s in log.sources] for name, log in asked[0].items()}
    assert files == {"asphalt": ["a.csv", "b.csv"], "sand": ["s.csv"]}
    assert (
        main(["diagnose", "--group", "a=a.csv", "--group", "b=a.csv", "-o", "out"]) == 2
    )
    assert "list it in only one of them" in capsys.readouterr().err


def test_a_bad_configuration_is_exit_78(stages, tmp_path, capsys):
    (tmp_path / "config.yaml").write_text("plant: {max_rmp: 1}\n")
    assert main(["diagnose", "a.csv", "-o", "out"]) == 78
    assert "did you mean" in capsys.readouterr().err


def test_a_program_that_nobody_writes_for_is_refused(stages, capsys):
    with pytest.raises(SystemExit):
        main(["diagnose", "a.csv", "--for", "gazebo", "-o", "out"])
    assert "gazebo is none of ros2_control" in capsys.readouterr().err
    assert not stages


def test_a_space_behind_a_comma_is_named(stages, capsys):
    with pytest.raises(SystemExit):  # as the shell splits: --for ros2_control, urdf
        main(["diagnose", "a.csv", "--for", "ros2_control,", "urdf", "-o", "out"])
    assert "'ros2_control,' has a comma without a name" in capsys.readouterr().err
    assert not stages


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (["a.csv", "--robot", "none.yaml"], 78, "none.yaml: no such file"),
        (
            ["--compare", "a.csv", "--against", "b.csv", "--for", "urdf"],
            2,
            "leave --compare",
        ),
    ],
)
def test_other_programs_and_robots_are_refused_before_any_judging(
    stages, capsys, words, code, says
):
    assert main(["diagnose", *words, "-o", "out"]) == code
    assert says in capsys.readouterr().err.splitlines()[-1]
    assert not [stage for stage in stages if stage[0] == "judge"]


def test_stopped_before_the_first_effect_it_names_no_file_that_is_not_there(
    stages, tmp_path, monkeypatch, capsys
):
    interrupted = lambda _attempt: os.kill(os.getpid(), signal.SIGINT)  # noqa: E731
    monkeypatch.setattr("hilserver.commands.diagnose.attempted", interrupted)
    main(["diagnose", "null.csv", "--try", "-o", "out"])
    said = capsys.readouterr().err.splitlines()[-1]
    assert said.endswith("stopped before any effect was tried; the report is written")
    assert (tmp_path / "out" / "report.html").exists()
    assert not (tmp_path / "out" / "power.json").exists()


def test_what_would_have_been_found_is_printed_and_written(
    stages, tmp_path, monkeypatch, capsys
):
    sizes = (Detectable(cause="body_lag", size=0.05, unit="s"),)
    tried = "hilserver.diagnosis.power.attempts.possible"
    library = {f"pose: {one.label}": one for one in pose_candidates(None)}
    monkeypatch.setattr(tried, lambda _task: library)

    def judged(attempt):
        found = [("named", ("gyro_bias",))]
        if attempt.times >= 1.0:
            found.append(("named", ("body_lag",)))
        return AttemptOutcome(tuple(found), sizes)

    monkeypatch.setattr("hilserver.commands.diagnose.attempted", judged)
    words = ["null.csv", "--try", "--causes", "body_lag,side_slip,gyro_bias"]
    assert main(["diagnose", *words, "--jobs", "1", "-o", "out"]) == 0
    said = capsys.readouterr()
    assert "side_slip is not tried: the recording does not show it" in said.err
    assert "gyro_bias is not tried: the recording shows it already" in said.err
    assert "5 of 5 tried: named in 3" in said.out
    assert "Power, no proof" in said.out
    assert len((tmp_path / "out" / "power.csv").read_text().splitlines()) == 6

    # a run without --try leaves none of it behind
    assert main(["diagnose", "null.csv", "-o", "out"]) == 0
    assert not (tmp_path / "out" / "power.csv").exists()
