"""A look at windows that another program has made."""

import numpy as np
import pytest
from hilserver_injector.make import make
from hilserver_injector.recipe import Recipe

from hilserver.diagnosis.replay.drive_stage import DriveStage
from hilserver.diagnosis.schema.evidence import Diagnosis, Evidence, FittedTerm
from hilserver.diagnosis.schema.findings import Finding, Parameter, Verdict
from hilserver.measured.channels import DUTIES
from hilserver.recalibration.judging import OrderJudge, proposed, steady, values_of
from hilserver.recalibration.orders import Todo
from tests.diagnosis.sample import findings
from tests.recalibration.windows import order, record, stopped, write

HIDDEN = {"rotation_gain": 0.06}


def judged(path, todo, **fields):
    return OrderJudge(order(path, todo, **fields)).result()


@pytest.fixture(scope="module")
def window(tmp_path_factory):
    return write(tmp_path_factory.mktemp("window") / "window.csv", HIDDEN, seed=5)


def test_the_right_model_gains_where_it_should(window):
    result = judged(window, Todo(2, {}, confirm=HIDDEN, level=0.001))
    assert result.error == ""
    assert result.look is None
    assert result.confirm.holds(0.001)
    assert result.confirm.gain["yaw_rad"].ratio > 3.0


@pytest.mark.parametrize("wrong", [{"rotation_gain": -0.06}, {"nav_latency": 0.2}])
def test_a_wrong_model_does_not_gain(window, wrong):
    assert not judged(window, Todo(2, {}, confirm=wrong, level=0.01)).confirm.holds(
        0.01
    )


def test_a_model_is_no_better_than_itself(window):
    compared = judged(window, Todo(2, HIDDEN, measure=HIDDEN)).measure
    assert (compared.p, compared.blocks) == (1.0, 0)


@pytest.mark.parametrize("after_s", [0.0, 6.0])
def test_a_robot_that_stands_says_nothing_of_what_turns(tmp_path, after_s):
    """Its sensors' noise is no evidence for or against a model."""
    path = stopped(tmp_path / "window.csv", HIDDEN, 5, after_s)
    result = judged(
        path, Todo(2, HIDDEN, measure={}, confirm={"wheel_radius": 0.03}, level=0.001)
    )
    assert result.error == ""
    assert not result.measure.resolves(0.05)
    assert not result.confirm.resolves(0.001)


def test_a_repaired_robot_takes_the_patch_back(window):
    result = judged(
        window, Todo(2, {**HIDDEN, "nav_scale": 0.1}, confirm=HIDDEN, level=0.001)
    )
    assert result.confirm.holds(0.001)


def test_a_damaged_window_is_named(tmp_path):
    path = tmp_path / "window_0001.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + bytes(200))
    result = judged(path, None)
    assert result.look is None
    assert "window_0001.mcap" in result.error


def test_a_window_that_is_gone_is_named(tmp_path):
    assert "window_0002.mcap" in judged(tmp_path / "window_0002.mcap", None).error


def duty_beyond_the_model(path):
    """Root mean square of what the model leaves of the duties [%]."""
    judge = OrderJudge(order(path))
    stage = DriveStage(judge.log, judge.robot, block_s=1.0)
    rows = np.concatenate(
        [np.arange(len(stage.stack))[stage.stack.edges[n]] for n in DUTIES]
    )
    return float((stage.stack.values - stage.predict({}))[rows].std())


@pytest.mark.parametrize(("late_ticks", "lost"), [(0, 0.0), (10, 0.0), (10, 0.05)])
def test_set_points_that_reach_the_robot_late_are_taken_when_it_followed_them(
    tmp_path, late_ticks, lost
):
    """Its duties have a noise of 0.15 %; nothing else is left where all of it is stamped."""
    path = record(
        tmp_path / "window.csv", {}, 3, late_ticks=late_ticks, lost=lost, length_s=30.0
    )
    assert duty_beyond_the_model(path) < (0.25 if lost else 0.16)


def test_set_points_that_nobody_has_stamped_leave_more_than_noise(tmp_path):
    path = record(tmp_path / "window.csv", {}, 3, stamped=False, length_s=30.0)
    assert duty_beyond_the_model(path) > 0.3


@pytest.mark.long
@pytest.mark.parametrize("floor", [{}, HIDDEN])
def test_set_points_that_reach_the_robot_late_are_no_change(tmp_path, floor):
    look = judged(
        record(tmp_path / "window.csv", floor, 4), Todo(2, floor, look=True)
    ).look
    assert (look.verdict, look.sentence) == ("as_running" if floor else "nothing", "")


@pytest.mark.long
def test_a_look_names_the_cause_and_the_next_window_holds_it(window, tmp_path):
    look = judged(window, None, report=str(tmp_path / "report")).look
    assert (look.verdict, look.causes) == ("named", ("rotation_gain",))
    assert look.terms["rotation_gain"].value == pytest.approx(0.06, abs=0.005)
    assert (tmp_path / "report" / "report.html").is_file()
    after = write(tmp_path / "next.csv", HIDDEN, seed=6)
    values = {name: term.value for name, term in look.terms.items()}
    again = judged(after, Todo(2, values, look=True)).look
    assert again.verdict == "as_running"


@pytest.mark.long
def test_what_runs_and_is_no_longer_there_goes(tmp_path):
    path = write(tmp_path / "window.csv", {}, seed=7)
    look = judged(path, Todo(2, HIDDEN, look=True)).look
    assert (look.verdict, look.terms, look.gone) == ("named", {}, HIDDEN)


@pytest.mark.long
@pytest.mark.parametrize("present", [0.0595, 0.03])
def test_a_value_stays_where_its_interval_holds_it(window, present):
    look = judged(window, Todo(2, {"rotation_gain": present}, look=True)).look
    assert look.verdict == ("as_running" if present == 0.0595 else "named")


@pytest.mark.long
def test_a_sensor_that_is_stuck_is_a_fault_and_no_patch(tmp_path):

    table, _ = make(Recipe(seed=8, causes=HIDDEN, duration_s=120.0))
    table.columns["imu.gyro_z_rad_s"][:] = 0.125
    path = tmp_path / "window.csv"
    table.write_csv(path)
    look = judged(path, None).look
    assert (look.verdict, look.terms) == ("data_fault", {})
    assert "gyro" in look.faults[0]


def fitted(**values):
    """Terms with values and half the widths of their intervals."""
    return [
        FittedTerm(
            name.replace("__", "."),
            Parameter(value=v, ci95=(v - half, v + half), unit="1"),
        )
        for name, (v, half) in values.items()
    ]


@pytest.mark.parametrize(
    ("found", "loaded", "terms"),
    [
        ({"rotation_gain": (0.002, 0.0003)}, {}, {}),
        (
            {"rotation_gain": (0.0035, 0.001)},
            {},
            {},
        ),  # it may be less than the least change
        ({"rotation_gain": (0.0035, 0.0003)}, {}, {"rotation_gain": 0.0035}),
        (
            {"rotation_gain": (0.032, 0.0003)},
            {"rotation_gain": 0.03},
            {"rotation_gain": 0.03},
        ),
        (
            {"rotation_gain": (0.035, 0.0003)},
            {"rotation_gain": 0.03},
            {"rotation_gain": 0.035},
        ),
        (
            {"nav_lever_arm__x": (-0.08, 0.01), "nav_lever_arm__y": (-0.0002, 0.01)},
            {},
            {"nav_lever_arm.x": -0.08},
        ),
        (
            {
                "stribeck_friction__f_s": (4.1, 0.05),
                "stribeck_friction__n_s": (3.0, 0.1),
            },
            {"stribeck_friction.f_s": 4.0},
            {"stribeck_friction.f_s": 4.0},  # a shape alone is no change
        ),
        ({"saturation_limit": (97.0, 0.5)}, {}, {}),
        ({"saturation_limit": (90.0, 0.5)}, {}, {"saturation_limit": 90.0}),
        ({"setpoint_rate_limit": (400.0, 1.0)}, {}, {"setpoint_rate_limit": 400.0}),
    ],
)
def test_a_change_counts_once_its_interval_is_beyond_the_least_change(
    found, loaded, terms
):
    assert values_of(proposed(fitted(**found), loaded, 0.1)) == terms


def test_without_a_least_change_whatever_the_data_resolve_counts():
    found = fitted(rotation_gain=(0.002, 0.0003))
    assert values_of(proposed(found, {}, 0.0)) == {"rotation_gain": 0.002}


def stuck(t_s, columns):
    for name in columns:
        columns[name][:] = columns[name][50]


def not_there(t_s, columns):
    for name in ("nav.x_m", "nav.y_m", "nav.yaw_rad", "imu.gyro_z_rad_s"):
        columns[name][:] = float("nan")


def jumping(t_s, columns):
    for name in columns:
        if "setpoint" not in name:
            columns[name][100::200] = 1e9


def clock_back(t_s, columns):
    t_s[len(t_s) // 2 :] -= 20.0


@pytest.mark.parametrize(
    "lie", [stuck, not_there, pytest.param(jumping, marks=pytest.mark.long), clock_back]
)
def test_a_robot_that_lies_gets_no_patch(tmp_path, lie):
    table, _ = make(Recipe(seed=9, duration_s=60.0))
    lie(table.t_s, table.columns)
    path = tmp_path / "window.csv"
    table.write_csv(path)
    result = judged(path, None)
    if result.error:
        assert "window.csv" in result.error
    else:
        assert result.look.verdict != "named"
        assert not result.look.terms


@pytest.mark.long
def test_what_runs_and_does_not_show_stays_beside_what_is_new(window):
    """A latency of 2 ms does not show in two minutes; the patch is the one that runs, and more."""
    look = judged(window, Todo(2, {"nav_latency": 0.002}, look=True)).look
    assert (look.verdict, look.causes) == ("named", ("rotation_gain",))
    assert look.terms["rotation_gain"].value == pytest.approx(0.06, abs=0.005)
    assert look.terms["nav_latency"].value == 0.002
    assert look.gone == {}


@pytest.mark.long
def test_what_runs_and_shows_stays_beside_what_is_new(tmp_path):
    both = {**HIDDEN, "nav_latency": 0.15}
    path = write(tmp_path / "window.csv", both, seed=12)
    look = judged(path, Todo(2, HIDDEN, look=True)).look
    assert (look.verdict, look.causes) == ("named", ("nav_latency",))
    assert look.terms["nav_latency"].value == pytest.approx(0.15, abs=0.02)
    assert look.terms["rotation_gain"].value == pytest.approx(0.06, abs=0.005)
    assert "rotat" not in look.sentence


@pytest.mark.long
def test_a_wrong_name_that_runs_goes_with_the_right_one(window):
    """A wheel radius of -6 % turns the robot, too, but drives it another way."""
    look = judged(window, Todo(2, {"wheel_radius": 0.05}, look=True)).look
    assert look.verdict == "named"
    assert look.gone == {"wheel_radius": 0.05}
    assert look.terms["rotation_gain"].value == pytest.approx(0.06, abs=0.005)


@pytest.mark.long
def test_missing_samples_are_said_and_bar_nothing(tmp_path):
    table, _ = make(Recipe(seed=5, causes=HIDDEN, duration_s=120.0))
    for at in range(500, 6000, 500):
        for name in ("nav.x_m", "nav.y_m", "nav.yaw_rad"):
            table.columns[name][at : at + 30] = float("nan")
    path = tmp_path / "window.csv"
    table.write_csv(path)
    look = judged(path, None).look
    assert (look.verdict, look.causes) == ("named", ("rotation_gain",))
    assert "missing" in look.faults[0]


@pytest.mark.long
@pytest.mark.parametrize(
    ("loaded", "verdict"), [({}, "too_small"), ({"wheel_radius": 0.005}, "as_running")]
)
def test_what_no_operator_would_thank_for_is_not_proposed(tmp_path, loaded, verdict):
    path = write(tmp_path / "window.csv", {"wheel_radius": 0.003}, seed=5)
    look = judged(path, Todo(2, loaded, look=True)).look
    assert (look.verdict, look.terms) == (verdict, {})


def test_what_only_acts_like_a_cause_is_not_proposed():
    """It needs an engineer's tick; a drift has no single value."""
    value = Parameter(value=0.1, ci95=(0.05, 0.15), unit="1")
    found = [
        Finding(
            verdict=verdict,
            causes=(name,),
            block="kinematics",
            parameters={name: value},
        )
        for name, verdict in (
            ("rotation_gain", Verdict.NAMED),
            ("wheel_radius", Verdict.NAMED_GROUP),
            ("nav_scale", Verdict.EFFECTIVE),
            ("gyro_scale", Verdict.DRIFT),
        )
    ]
    terms = tuple(FittedTerm(f.causes[0], value) for f in found)
    given = findings().model_copy(update={"findings": tuple(found)})
    kept = steady(Diagnosis(given, Evidence(extension=terms)))
    assert [term.name for term in kept] == ["rotation_gain", "wheel_radius"]
