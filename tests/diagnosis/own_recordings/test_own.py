"""The daemon's own recordings: nothing is found in them, and a term that was on is named."""

import pytest

from hilserver.daemon.assembly import assemble_config
from hilserver.diagnosis.engine import diagnose
from tests.diagnosis.assertions import LARGEST_GROUP, nothing_is_found, said
from tests.diagnosis.own_recordings.cases import DROVE, HIDDEN, ROWS
from tests.diagnosis.own_recordings.recordings import configuration, read

QUICK = {
    ("wheels, noise", "1 kHz"),
    ("wheels, noise", "100 Hz, between the sensors' runs"),
    ("wheels, noise", "50 Hz, navigation empty"),
    ("wheels, noise", "50 Hz, under way"),
    ("wheels, noise", "33 ms"),
    ("body, no noise", "1 kHz, the recorder's own"),
}
CASES = [
    pytest.param(drive, rows, marks=[] if (drive, rows) in QUICK else [pytest.mark.long])
    for drive in DROVE
    for rows in ROWS
]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Return a function that gives the recording of a drive; each is driven once."""
    folder, made = tmp_path_factory.mktemp("own"), {}

    def of(name):
        if name not in made:
            made[name] = DROVE[name].record(folder / f"{len(made)}.mcap")
        return made[name]

    return of


def found_in(log):
    return diagnose(log, assemble_config(configuration(noisy=True))).findings


@pytest.mark.timeout(600)
@pytest.mark.parametrize(("drive", "rows"), CASES)
def test_nothing_is_found_in_a_recording_of_the_simulation(drive, rows, recorded, tmp_path):
    nothing_is_found(found_in(read(recorded(drive), tmp_path, ROWS[rows])))


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
