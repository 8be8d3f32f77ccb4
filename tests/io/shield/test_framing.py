"""Requests in a stream of bytes: found, and found again after whatever goes wrong."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilserver.io.shield import words as w
from hilserver.io.shield.framing import COMPLETE, feed, stands_alone
from hilserver.io.shield.protocol import REQUEST_BYTES, ShieldCommand, request

PAUSE = None
"""Stands in a stream for silence on the line."""

commands = st.sampled_from(list(ShieldCommand))
requests = st.builds(request, commands, st.binary(min_size=8, max_size=8))
payloads = st.binary(min_size=8, max_size=8)
variants = st.sampled_from(["iotbot", "crc"])


class Line:
    """What the thread of the line does with bytes, without a line."""

    def __init__(self, variant="iotbot"):
        self.state = np.zeros(w.N_WORDS, dtype=np.int64)
        self.state[w.CRC] = variant == "crc"
        self.buffer = np.zeros(REQUEST_BYTES, dtype=np.uint8)
        self.alone = []
        self._after_pause = True

    def take(self, *pieces):
        """Return the requests in pieces of bytes and pauses."""
        found = []
        for piece in pieces:
            if piece is PAUSE:
                self._pause()
                continue
            for byte in piece:
                if feed(byte, self._after_pause, self.buffer, self.state) == COMPLETE:
                    found.append(bytes(self.buffer))
                self._after_pause = False
        return found

    def _pause(self):
        self._after_pause = True
        if stands_alone(self.state):
            self.alone.append(bytes(self.buffer))
            self.state[w.FILL] = 0

    @property
    def skipped(self):
        return int(self.state[w.SKIPPED])


RPM = request(ShieldCommand.SET_RPM, bytes(range(8)))


@given(
    variants,
    st.lists(st.tuples(commands, st.binary(min_size=8, max_size=8)), max_size=6),
    st.booleans(),
)
def test_requests_are_found_with_and_without_pauses(variant, asked, pauses):
    sent = [request(command, payload, variant) for command, payload in asked]
    line, stream = Line(variant), []
    for frame in sent:
        stream += [PAUSE, frame] if pauses else [frame]
    assert line.take(*stream) == sent
    assert line.skipped == 0


@given(variants, st.binary(max_size=400), commands, st.binary(min_size=8, max_size=8))
def test_after_any_bytes_and_a_pause_the_next_request_is_found(
    variant, noise, command, payload
):
    """At once if the noise left the line out of step, else with the one after it."""
    line, frame = Line(variant), request(command, payload, variant)
    line.take(noise, PAUSE)
    if line.state[w.IN_STEP] == 0:
        assert line.take(frame)[-1] == frame
    else:
        line.take(frame, PAUSE)
        assert line.take(frame)[-1:] == [frame]


@given(requests, st.integers(0, 10), st.lists(requests, min_size=3, max_size=3))
def test_a_lost_byte_costs_that_request_and_none_that_begins_after_a_pause(
    frame, lost, later
):
    line = Line()
    line.take(frame, PAUSE)
    short = frame[:lost] + frame[lost + 1 :]
    found = line.take(short, PAUSE, *(piece for f in later for piece in (f, PAUSE)))
    assert found[-2:] == later[-2:]


@given(requests, st.integers(0, 10), st.lists(requests, min_size=3, max_size=3))
def test_a_doubled_byte_costs_no_more(frame, doubled, later):
    line = Line()
    line.take(frame, PAUSE)
    long = frame[: doubled + 1] + frame[doubled:]
    found = line.take(long, PAUSE, *(piece for f in later for piece in (f, PAUSE)))
    assert found[-2:] == later[-2:]


def test_a_lost_byte_costs_one_request():
    line = Line()
    assert line.take(RPM, PAUSE, RPM[:4] + RPM[5:], PAUSE, RPM, PAUSE, RPM) == [RPM] * 3
    assert line.skipped == REQUEST_BYTES - 1


def test_a_doubled_request_is_two_requests():
    assert Line().take(RPM + RPM) == [RPM, RPM]


def test_half_a_request_waits_for_its_other_half():
    line = Line()
    assert line.take(RPM, PAUSE, RPM[:5], PAUSE, RPM[5:]) == [RPM, RPM]
    assert line.skipped == 0


def test_half_a_request_without_its_other_half_costs_nothing_but_itself():
    line = Line()
    assert line.take(RPM, PAUSE, RPM[:5], PAUSE, RPM) == [RPM, RPM]
    assert line.skipped == 5


def test_a_window_that_only_looks_right_does_not_last():
    """The payload holds end and start side by side, over and over, and the line lost a byte."""
    frame = request(ShieldCommand.SET_RPM, bytes((0, 0xEE, 0xFF, 0x11, 0, 0, 0, 0)))
    line = Line()
    found = line.take(frame[1:], *(piece for _ in range(5) for piece in (PAUSE, frame)))
    assert found[-4:] == [frame] * 4


def test_eleven_bytes_between_two_pauses_are_a_request_whatever_the_last_one_is():
    line = Line()
    odd = RPM[:10] + b"\x07"
    assert line.take(odd, PAUSE, RPM, PAUSE) == [RPM]
    assert line.alone == [odd]
    crc = Line("crc")
    assert crc.take(odd, PAUSE) == []
    assert not crc.alone


@pytest.mark.parametrize("stray", [0x11, 0x13])
def test_flow_control_of_the_host_is_noise_between_requests(stray):
    line, odd = Line(), RPM[:10] + b"\x07"
    assert line.take(bytes((stray,)) + RPM, PAUSE, bytes((stray,)) + odd, PAUSE) == [
        RPM
    ]
    assert (line.skipped, line.alone) == (2, [odd])
