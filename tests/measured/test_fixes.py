"""Latitude and longitude become metres in one plane; what is no fix is no sample."""

import numpy as np
import pytest

from hilserver.errors import LogError
from hilserver.measured.conversion import read_any
from hilserver.measured.fixes import east_north_m
from hilserver.measured.reading import read_measured
from tests.measured.test_foreign_bags import at, header, joints, store, write

ORIGIN = np.array([48.7, 9.1])
MAPPING = """
channels:
  wheel.fl.speed_rpm: {column: left}
  wheel.fr.speed_rpm: {column: right, sign: -1}
  fix.latitude_deg: {column: lat}
  fix.longitude_deg: {column: lon}
"""
NAVSATFIX = "sensor_msgs/msg/NavSatFix"


def table(folder, name="run.csv", n=300, lat=None, more="", **columns):
    """Write a drive to the north east; `lat` replaces the latitudes."""
    t_s = 0.1 * np.arange(n)
    found = {
        "t_s": t_s,
        "left": np.full(n, 60.0),
        "right": np.full(n, 60.0),
        "lat": ORIGIN[0] + 1e-6 * t_s if lat is None else lat,
        "lon": ORIGIN[1] + 1e-6 * t_s,
        **columns,
    }
    path = folder / name
    rows = np.column_stack(list(found.values()))
    np.savetxt(path, rows, "%.10f", ",", header=",".join(found), comments="")
    (folder / "map.yaml").write_text(MAPPING + more)
    return path


def test_degrees_are_as_long_as_tables_of_the_ellipsoid_say():
    """Lengths of a degree on WGS 84, as the National Geospatial-Intelligence Agency lists them."""
    for latitude, north_m, east_m in ((0, 110_574, 111_320), (45, 111_132, 78_847)):
        origin = np.array([latitude, -120.0])
        east, north = east_north_m(origin + 1e-3 * np.eye(2), origin).T
        assert 1e3 * north[0] == pytest.approx(north_m, abs=1.0)
        assert 1e3 * east[1] == pytest.approx(east_m, abs=1.0)
        assert abs(east[0]) < 1e-9


def test_a_table_of_fixes_is_a_position_whose_errors_last(tmp_path):
    log = read_measured([table(tmp_path)], tmp_path / "map.yaml")
    assert log.pose_errors_last
    assert "it shows no heading" in log.notices[0]
    assert not any(name.startswith("fix.") for name in log.channels)
    x, y = (log[name].values for name in ("nav.x_m", "nav.y_m"))
    assert (x[0], y[0]) == (0.0, 0.0)
    assert y[-1] == pytest.approx(29.9e-6 * 111_204, rel=1e-3)
    assert x[-1] == pytest.approx(29.9e-6 * 73_602, rel=1e-3)


def test_two_logs_share_the_first_fix(tmp_path):
    first = table(tmp_path)
    second = table(tmp_path, "other.csv", lat=np.linspace(48.701, 48.702, 300))
    log = read_measured([first, second], tmp_path / "map.yaml")
    assert log["nav.y_m"].of(1)[1][0] == pytest.approx(111.2, abs=0.1)


def test_integers_of_a_receiver_have_a_scale(tmp_path):
    path = table(tmp_path, lat=np.rint(1e7 * ORIGIN[0] + np.arange(300.0)))
    scaled = MAPPING.replace("column: lat", 'column: lat, unit: "1", scale: 1.0e-7')
    (tmp_path / "map.yaml").write_text(scaled)
    log = read_measured([path], tmp_path / "map.yaml")
    assert np.diff(log["nav.y_m"].values) == pytest.approx(0.0111, abs=1e-3)


def test_rows_without_a_good_fix_are_no_samples(tmp_path):
    lat = ORIGIN[0] + 1e-7 * np.arange(300)
    lat[:10], lat[20:23] = 0.0, np.nan
    variance = np.where(np.arange(300) < 250, 4e-4, 4.0)
    status = np.where(np.arange(300) == 100, -1.0, 0.0)
    lon = np.where(np.arange(300) < 10, 0.0, ORIGIN[1] + 1e-7 * np.arange(300))
    more = "  fix.variance_m2: {column: var}\n  fix.status: {column: st}\n"
    path = table(tmp_path, lat=lat, more=more, lon=lon, var=variance, st=status)
    log = read_measured([path], tmp_path / "map.yaml")
    assert len(log["nav.x_m"]) == 300 - 10 - 3 - 1 - 50
    said = " ".join(log.notices)
    assert "11 of 297 positions, without a fix" in said
    assert "50 of 297 positions, whose stated error" in said


@pytest.mark.parametrize(
    ("lat", "says"),
    [
        (np.full(300, 91.0), "is no place on the earth"),
        (np.linspace(48.0, 49.5, 300), "km from the first one"),
    ],
)
def test_impossible_fixes_are_one_sentence(tmp_path, lat, says):
    with pytest.raises(LogError, match=says):
        read_measured([table(tmp_path, lat=lat)], tmp_path / "map.yaml")


def test_what_a_receiver_writes_without_a_fix_need_not_be_a_place(tmp_path):
    lat = ORIGIN[0] + 1e-6 * np.arange(300)
    lat[:10] = 999.0
    status = np.where(np.arange(300) < 10, -1.0, 0.0)
    path = table(tmp_path, lat=lat, more="  fix.status: {column: st}\n", st=status)
    log = read_measured([path], tmp_path / "map.yaml")
    assert len(log["nav.x_m"]) == 290


def test_degrees_that_repeat_are_metres_that_repeat(tmp_path):
    """The plane is curved: a step to the east alone moves the metres to the north as well."""
    lat = np.round(ORIGIN[0] + 1e-6 * np.arange(300), 5)
    lon = np.round(ORIGIN[1] + 1e-6 * np.arange(300), 5)
    path = table(tmp_path, lat=lat, lon=lon)
    log = read_measured([path], tmp_path / "map.yaml")
    for degrees, name in ((lat, "nav.y_m"), (lon, "nav.x_m")):
        repeats = np.diff(degrees) == 0.0
        assert np.array_equal(np.diff(log[name].values) == 0.0, repeats)


def test_a_log_without_any_fix_says_so(tmp_path):
    path = table(tmp_path, lat=np.full(300, np.nan))
    log = read_measured([path], tmp_path / "map.yaml")
    assert "nav.x_m" not in log
    assert "contains no fix of the satellites" in " ".join(log.notices)


def test_a_receiver_that_repeats_one_fix_is_one_sentence(tmp_path):
    path = table(tmp_path, lat=np.full(300, ORIGIN[0]), lon=np.full(300, ORIGIN[1]))
    with pytest.raises(LogError, match="never changes: the receiver repeats one fix"):
        read_measured([path], tmp_path / "map.yaml")


def test_a_latitude_alone_and_two_positions_are_refused(tmp_path):
    path = table(tmp_path)
    (tmp_path / "map.yaml").write_text(
        MAPPING.replace("  fix.longitude_deg: {column: lon}\n", "")
    )
    with pytest.raises(LogError, match=r"fix.longitude_deg must stand beside"):
        read_measured([path], tmp_path / "map.yaml")
    (tmp_path / "map.yaml").write_text(MAPPING + "  nav.x_m: {column: lat}\n")
    with pytest.raises(LogError, match=r"has both nav\.x_m and fix"):
        read_measured([path], tmp_path / "map.yaml")


def test_a_converted_log_holds_the_position(tmp_path):
    log = read_any(table(tmp_path), str(tmp_path / "map.yaml"))
    assert {"nav.x_m", "nav.y_m"} <= set(log.columns)
    assert not any(name.startswith("fix.") for name in log.columns)


def fix(i, status=0):
    t = store().types
    message = t[NAVSATFIX](
        header(t, i),
        t["sensor_msgs/msg/NavSatStatus"](status=status, service=1),
        ORIGIN[0] + 1e-6 * i,
        ORIGIN[1],
        300.0,
        np.full(9, 4e-4),
        2,
    )
    return "/fix", NAVSATFIX, at(i), message


@pytest.fixture
def bag(tmp_path):
    names, sent = ("left_wheel_joint", "right_wheel_joint"), []
    for i in range(300):
        sent.append(joints(i, names, [5.0 + 0.01 * i, 5.0 + 0.01 * i]))
        sent.append(fix(i, status=-1 if i < 5 else 0))
    return write(tmp_path / "bag", sent)


def test_a_bag_of_fixes_is_proposed_and_read(tmp_path, bag):
    with pytest.raises(LogError) as raised:
        read_measured([bag])
    proposal = raised.value.proposal
    assert 'fix.latitude_deg: {topic: "/fix", field: latitude}' in proposal
    (tmp_path / "map.yaml").write_text(proposal)
    log = read_measured([bag], tmp_path / "map.yaml")
    assert len(log["nav.y_m"]) == 295
    assert np.diff(log["nav.y_m"].values) == pytest.approx(0.1112, abs=1e-3)
    assert any("status says that there is no fix" in note for note in log.notices)
