"""Plans: what a manoeuvre can show and cannot, and a better one that the daemon executes."""

import json
import os
import signal

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from hilserver.commands import main
from hilserver.daemon.assembly import assemble
from hilserver.diagnosis.engine import judge
from hilserver.diagnosis.plan.document import PlanDocument
from hilserver.diagnosis.plan.manoeuvre import (
    Manoeuvre,
    as_scenario,
    of_log,
    of_scenario,
)
from hilserver.diagnosis.plan.null_log import (
    GROUPS,
    PlannedRecording,
    Studio,
    null_log,
    path_of,
)
from hilserver.diagnosis.plan.outlook import grouped, look
from hilserver.diagnosis.plan.pieces import MARGIN_M, of_moves, pieces
from hilserver.diagnosis.plan.planning import PLAN, SCENARIO
from hilserver.diagnosis.plan.search import choose
from hilserver.diagnosis.replay.judgeable import NO_STAGE
from hilserver.faults.scenario import as_yaml
from hilserver.measured.channels import POSITION, SETPOINTS
from hilserver.measured.reading import read_measured
from hilserver.testing.opening import open_hil

ROBOT = assemble(None).robot
ROTATION = {
    "rotation_gain",
    "gyro_scale",
    "side_slip",
    "icr_offset",
    "longitudinal_slip",
}
STRAIGHT = of_moves([(1, 0, 0), (4, 45, 45), (1, 0, 0), (4, -45, -45), (1, 0, 0)] * 3)
CIRCLE = of_moves([(20, 30, 60)])


def seen(*spans, recording=None):
    recording = recording or PlannedRecording()
    return look(spans, recording, Studio(ROBOT, 0, 2, lambda text, share: None))


def written(folder, manoeuvre, name="given.yaml"):
    path = folder / name
    path.write_text(as_yaml(as_scenario([manoeuvre], "given")))
    return path


def recorded(path, manoeuvre, rate_hz=50.0):
    t = np.arange(0.0, manoeuvre.duration_s + 1e-9, 1.0 / rate_hz)
    table = np.column_stack([t, manoeuvre.held(t)])
    header = ",".join(["t_s", *SETPOINTS])
    np.savetxt(path, table, "%.9g", delimiter=",", header=header, comments="")
    return path


def test_a_manoeuvre_without_motion_shows_the_bias_of_the_gyro_and_no_more():
    outlook = seen(of_moves([(10, 0, 0)]))
    assert list(outlook.sizes) == ["gyro_bias"]
    assert outlook.groups == []
    for cause in ("surface_change", "imu_latency", "floor_slope"):
        assert outlook.not_judged[cause]


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    """A circle at one speed, and what is proposed for 40 s in its place."""
    folder = tmp_path_factory.mktemp("plan")
    path = recorded(folder / "circle.csv", CIRCLE)
    out = folder / "out"
    assert main(["plan", str(path), "--duration", "40", "-o", str(out)]) == 0
    return out


def document(folder):
    return PlanDocument.model_validate_json((folder / PLAN).read_text())


# --- what a manoeuvre can show --------------------------------------------------------------------


def test_a_straight_drive_cannot_show_rotation():
    outlook = seen(STRAIGHT)
    assert set(outlook.not_judged) >= ROTATION
    assert "hardly excited" in outlook.not_judged["rotation_gain"]
    assert {"wheel_radius_difference", "nav_latency", "process_gain"} <= set(
        outlook.shown
    )


def test_a_circle_at_one_speed_cannot_tell_nav_latency_from_side_slip():
    assert any(
        {"nav_latency", "side_slip"} <= set(group) for group in seen(CIRCLE).groups
    )


def test_what_is_not_recorded_is_not_judged():
    channels = (*GROUPS["speed"], *GROUPS["gyro"])
    outlook = seen(CIRCLE, recording=PlannedRecording(channels))
    assert outlook.not_judged["nav_scale"] == "no position in the log"
    assert outlook.not_judged["yaw_latency"] == "no navigation yaw in the log"
    assert any(
        {"rotation_gain", "gyro_scale"} <= set(group) for group in outlook.groups
    )


def test_a_position_by_satellites_is_off_for_long():
    off_m = []
    for rng in (None, np.random.default_rng(1)):
        recording = PlannedRecording(POSITION, satellites_m=2.0)
        log = null_log([CIRCLE], ROBOT, recording, rng)
        assert log.pose_errors_last
        off_m.append(log[POSITION[0]].values)
    error = off_m[1] - off_m[0]
    assert abs(error.mean()) > 0.3  # the length of the drive does not average it away
    assert 0.1 < np.diff(error).std() < 1.0


def test_twice_the_drive_shows_less_than_twice_as_small():
    # without the gyro: a late one shows in a few moments of a circle alone, and a cause that does
    # raises the critical value of all others
    still = PlannedRecording((*GROUPS["speed"], *GROUPS["position"], *GROUPS["yaw"]))
    once = seen(CIRCLE, recording=still).sizes["side_slip"].size
    four = seen(CIRCLE, CIRCLE, CIRCLE, CIRCLE, recording=still).sizes["side_slip"].size
    assert 0.35 < four / once < 0.75


def test_why_a_cause_is_not_judged_is_a_whole_sentence_without_its_details():
    for reason in NO_STAGE.values():
        short = reason.partition(":")[0]
        assert short.count("(") == short.count(")")


def test_exact_twins_stay_a_group_whatever_is_driven(planned):
    groups = [set(group.causes) for group in document(planned).proposed.groups]
    assert {"icr_offset", "nav_lever_arm"} in groups


def test_groups_hold_only_what_is_alike_pair_by_pair():
    pairs = {("a", "b"): 1.0, ("b", "c"): 0.97, ("a", "c"): 0.96, ("c", "d"): 0.99}
    assert grouped(pairs) == [("a", "b", "c"), ("c", "d")]
    assert grouped({}) == []


# --- the better manoeuvre -------------------------------------------------------------------------


def test_the_proposed_manoeuvre_separates_nav_latency_from_side_slip(planned):
    plan = document(planned)
    together = {"nav_latency", "side_slip"}
    assert any(together <= set(group.causes) for group in plan.as_planned.groups)
    assert not any(together <= set(group.causes) for group in plan.proposed.groups)
    assert together <= {found.cause for found in plan.proposed.causes if found.shows}
    assert plan.proposed.better
    assert plan.proposed.score > plan.as_planned.score
    assert plan.proposed.duration_s <= 40.0


@pytest.mark.parametrize(
    "cause", ["nav_latency", pytest.param("side_slip", marks=pytest.mark.long)]
)
def test_a_diagnosis_names_on_it_what_the_plan_promises(planned, cause):
    plan = document(planned)
    reference = next(
        found.reference for found in plan.proposed.causes if found.cause == cause
    )
    spans = of_scenario(planned / SCENARIO, ROBOT, 40.0)
    log = null_log(
        spans, ROBOT, PlannedRecording(), np.random.default_rng(3), {cause: reference}
    )
    assert [f.causes for f in judge(log, ROBOT).findings.findings] == [(cause,)]


def test_a_diagnosis_finds_nothing_in_the_null_log(planned):
    spans = of_scenario(planned / SCENARIO, ROBOT, 40.0)
    log = null_log(spans, ROBOT, PlannedRecording(), np.random.default_rng(3))
    assert not judge(log, ROBOT).findings.findings


async def test_the_daemon_drives_the_proposed_manoeuvre_inside_the_room(planned):
    (manoeuvre,) = of_scenario(planned / SCENARIO, ROBOT)
    ticks = round(manoeuvre.duration_s / 1e-3)
    names = ("wheel.fl.setpoint_rpm", "wheel.rr.setpoint_rpm", "pose.x_m", "pose.y_m")
    async with open_hil(None, "virtual", scenario=planned / SCENARIO) as hil:
        async with hil.capture(*names) as trace:
            await hil.step(ticks)
        assert hil.daemon.gate.owner == "scenario"
    wanted = manoeuvre.held(trace.tick * 1e-3)
    assert np.array_equal(trace[names[0]].values, wanted[:, 0])
    assert np.array_equal(trace[names[1]].values, wanted[:, 3])
    ((x, y, _),) = path_of([manoeuvre], ROBOT)
    for name, foreseen in ((names[2], x), (names[3], y)):
        assert np.abs(trace[name].values).max() <= 2.5
        assert trace[name].values[-1] == pytest.approx(foreseen[-1], abs=0.02)
    assert np.ptp(trace[names[2]].values) > 1.0


def test_pieces_stay_in_the_room_and_come_back():
    for room in ((5.0, 5.0), (3.0, 2.0)):
        found = pieces(ROBOT, room)
        assert len(found) > 10
        assert not [piece.name for piece in found if piece.name.startswith("1 turns")]
        for x, y, _ in path_of([piece.manoeuvre for piece in found], ROBOT):
            assert np.abs(x).max() <= 0.5 * room[0] - MARGIN_M
            assert np.abs(y).max() <= 0.5 * room[1] - MARGIN_M
            assert np.hypot(x[-1], y[-1]) < 0.1


def test_no_choice_is_longer_than_allowed_and_little_time_is_left():
    found = pieces(ROBOT, (4.0, 4.0))
    shortest_s = min(piece.manoeuvre.duration_s for piece in found)
    for duration_s in (0.5, 3.0, 10.0, 61.0):
        chosen = choose(found, [], duration_s, lambda text, share: None)
        left_s = duration_s - sum(piece.manoeuvre.duration_s for piece in chosen)
        assert -1e-6 <= left_s < shortest_s


# --- reading and writing --------------------------------------------------------------------------


@settings(max_examples=50, deadline=None)
@given(
    st.lists(st.tuples(st.integers(1, 3000), *[st.integers(-900, 900)] * 4), min_size=2)
)
def test_a_scenario_plays_the_manoeuvre_it_was_made_of(tmp_path_factory, moves):
    at_s = np.cumsum([0, *[ms for ms, *_ in moves[:-1]]]) / 1000.0
    rpm = 0.1 * np.array([move[1:] for move in moves], dtype=float)
    made = Manoeuvre(at_s, rpm, max(float(at_s[-1]) + 1.0, 2.0))
    path = written(tmp_path_factory.mktemp("s"), made)
    (read,) = of_scenario(path, ROBOT, made.duration_s)
    t = np.arange(0.0005, made.duration_s - 1e-3, 0.001)
    assert np.allclose(read.held(t), made.held(t), atol=1e-4)


def test_a_log_of_twists_is_the_same_manoeuvre_as_its_scenario(tmp_path):
    rows = [
        (0.0, 0.0, 0.0),
        (1.0, 0.3, 0.5),
        (3.0, -0.2, 0.0),
        (5.0, 0.0, 0.0),
        (6.0, 0.0, 0.0),
    ]
    log = tmp_path / "log.csv"
    text = "t_s,twist.linear_m_s,twist.angular_rad_s\n"
    log.write_text(text + "".join(f"{t},{v},{om}\n" for t, v, om in rows))
    scenario = tmp_path / "scenario.yaml"
    steps = [
        {
            "at_s": t,
            "write": {
                "control.mode": 1,
                "twist.linear_m_s": v,
                "twist.angular_rad_s": om,
            },
        }
        for t, v, om in rows
    ]
    scenario.write_text(yaml.safe_dump({"steps": steps}))
    (from_log,) = of_log(read_measured([log]), ROBOT)
    (from_scenario,) = of_scenario(scenario, ROBOT, 6.0)
    t = np.arange(0.01, 5.9, 0.02)
    assert np.allclose(from_log.held(t), from_scenario.held(t))
    left, right = from_log.held(np.array([4.0]))[0][[0, 3]]
    assert left < 0.0 < right  # backwards


@pytest.mark.long
def test_the_documents_are_the_same_again(planned, tmp_path):
    again = tmp_path / "again"
    path = planned.parent / "circle.csv"
    assert main(["plan", str(path), "--duration", "40", "-o", str(again)]) == 0
    for name in (PLAN, SCENARIO):
        assert (again / name).read_text() == (planned / name).read_text()


def test_it_says_what_a_channel_would_add(tmp_path, capsys):
    path = written(tmp_path, CIRCLE)
    out = str(tmp_path / "out")
    assert (
        main(
            ["plan", str(path), "--channels", "speed,gyro", "--room", "4x3", "-o", out]
        )
        == 0
    )
    said = capsys.readouterr().out
    assert "also with yaw: " in said
    assert "cannot separate: gyro_scale, rotation_gain, wheel_radius" in said
    missing = {m.channel: m for m in document(tmp_path / "out").missing_channels}
    assert set(missing) == {"duty", "position", "yaw", "voltage"}
    assert {"floor_slope", "nav_lever_arm"} <= set(missing["position"].shows)
    assert "gyro_scale" in missing["position"].separates
    assert (
        json.loads((tmp_path / "out" / PLAN).read_text())["schema"]
        == "hilserver.plan/1"
    )


@pytest.mark.parametrize(
    ("text", "code", "sentence"),
    [
        ("steps: []\n", 78, "writes no set-points"),
        ("steps: [{at_s: 0, write: {lights.red: 3}}]\n", 78, "writes no set-points"),
        (
            "steps: [{at_s: 9000, write: {twist.linear_m_s: 0.1}}]\n",
            78,
            "lasts 9e+03 s",
        ),
        (
            "steps: [{at_s: 0, write: {wheels.setpoints_rpm: [1, 2]}}]\n",
            78,
            "a list of 4",
        ),
        ("step: []\n", 78, "unknown key 'step'"),
    ],
)
def test_what_is_no_manoeuvre_is_one_sentence(tmp_path, capsys, text, code, sentence):
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    assert main(["plan", str(path), "-o", str(tmp_path / "out")]) == code
    said = capsys.readouterr().err
    assert sentence in said
    assert said.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_log_without_set_points_is_one_sentence(tmp_path, capsys):
    path = tmp_path / "bad.csv"
    path.write_text("t_s,nav.x_m\n0,1\n1,2\n2,3\n")
    assert main(["plan", str(path), "-o", str(tmp_path / "out")]) == 2
    assert "contains no set-points" in capsys.readouterr().err


@pytest.mark.parametrize(
    "option", [["--room", "5"], ["--room", "0x9"], ["--channels", "smell"]]
)
def test_options_that_make_no_sense_are_refused(tmp_path, capsys, option):
    with pytest.raises(SystemExit):
        main(["plan", "x.yaml", "-o", str(tmp_path), *option])
    assert f"argument {option[0]}: " in capsys.readouterr().err


@pytest.mark.parametrize("moment", ["assemble", "plan"])
def test_a_signal_is_one_sentence_and_leaves_nothing(
    tmp_path, monkeypatch, capsys, moment
):
    interrupted = lambda *_: os.kill(os.getpid(), signal.SIGINT)  # noqa: E731
    monkeypatch.setattr(f"hilserver.commands.plan.{moment}", interrupted)
    assert main(["plan", "x.yaml", "-o", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().err
    assert (
        said == "hilserver: stopped before the plan was finished: nothing was written\n"
    )
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "options", [["--channels", "voltage"], ["--channels", "yaw", "--satellites", "0.5"]]
)
def test_channels_that_show_nothing_are_one_sentence(tmp_path, capsys, options):
    path = written(tmp_path, STRAIGHT)
    args = ["plan", str(path), "--duration", "10", "-o", str(tmp_path / "out")]
    assert main([*args, *options]) == 1
    said = capsys.readouterr().err
    assert "these channels show no effect: record the wheel speeds, too" in said


def test_too_small_a_room_is_one_sentence(tmp_path, capsys):
    path = written(tmp_path, STRAIGHT)
    args = [
        "plan",
        str(path),
        "--duration",
        "2",
        "--room",
        "1x1",
        "-o",
        str(tmp_path / "out"),
    ]
    assert main(args) == 1
    assert "no piece fits" in capsys.readouterr().err
