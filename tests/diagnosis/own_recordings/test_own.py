"""The daemon's own recordings: nothing is found in them, and a term that was on is named."""

from dataclasses import replace

import pytest

from tests.diagnosis.assertions import (
    LARGEST_GROUP,
    nothing_is_found,
    said,
    the_cause_is_named,
)
from tests.diagnosis.own_recordings.cases import DROVE, HIDDEN, ROWS
from tests.diagnosis.own_recordings.recordings import Drive, Rows, found_in, read

QUICK = {
    ("wheels, noise", "1 kHz"),
    ("wheels, noise", "100 Hz, between the sensors' runs"),
    ("wheels, noise", "50 Hz, navigation empty"),
    ("wheels, noise", "50 Hz, under way"),
    ("wheels, noise", "33 ms"),
    ("body, no noise", "1 kHz, the recorder's own"),
}
QUICK_S = 20.0


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Return a function that gives the recording of a drive; each is driven once."""
    made = {}

    def of(drive):
        key = repr(drive)
        if key not in made:
            folder = tmp_path_factory.mktemp("own")
            made[key] = drive.record(folder / "run.mcap")
        return made[key]

    return of


def nothing_is_found_in(recording, rows, folder):
    nothing_is_found(found_in(read(recording, folder, ROWS[rows])))


@pytest.mark.parametrize(("drive", "rows"), sorted(QUICK))
def test_nothing_is_found_in_a_short_recording(drive, rows, recorded, tmp_path):
    short = replace(DROVE[drive], seconds=QUICK_S)
    nothing_is_found_in(recorded(short), rows, tmp_path)


def test_between_their_rows_wheels_turn_as_the_drive_that_was_found(
    tmp_path, monkeypatch
):
    """Of a long recording not every row of the wheels is used; the pose needs those between."""
    monkeypatch.setattr("hilserver.measured.frames.ENOUGH_ROWS", 600)
    late = Drive("wheels", 12.0, 21, terms={"actuation_delay": 0.04})
    found = found_in(
        read(late.record(tmp_path / "run.mcap"), tmp_path, Rows(whole=True))
    )
    the_cause_is_named(found, "actuation_delay")


@pytest.mark.long
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("rows", ROWS)
@pytest.mark.parametrize("drive", DROVE)
def test_nothing_is_found_in_a_recording_of_the_daemon(drive, rows, recorded, tmp_path):
    nothing_is_found_in(recorded(DROVE[drive]), rows, tmp_path)


@pytest.mark.long
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("hidden", HIDDEN, ids=lambda hidden: hidden.cause)
def test_a_term_at_its_reference_size_is_named(hidden, tmp_path):
    source = hidden.drive.record(tmp_path / "run.mcap")
    findings = found_in(read(source, tmp_path, hidden.rows))
    assert len(findings.findings) == 1, said(findings)
    (finding,) = findings.findings
    assert hidden.cause in finding.causes, said(findings)
    assert len(finding.causes) <= LARGEST_GROUP
