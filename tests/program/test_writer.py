"""Nobody waits for a terminal or a pipe that does not take lines."""

import os
import time

from hilserver.program import writer as module
from hilserver.program.writer import Writer


def read_all(fd, seconds=2.0):
    os.set_blocking(fd, False)
    text, end_s = b"", time.monotonic() + seconds
    while time.monotonic() < end_s and b"last" not in text:
        try:
            text += os.read(fd, 65536)
        except BlockingIOError:
            time.sleep(0.01)
    return text.decode()


def test_a_pipe_that_nobody_reads_costs_lines_and_nothing_else():
    reading, writing = os.pipe()
    with os.fdopen(writing, "w") as stream:
        writer = Writer(stream)
        start_s = time.monotonic()
        for number in range(10_000):
            writer.write(f"{number:060}\n")
        writer.drain(0.1)
        assert time.monotonic() - start_s < 5.0, "the pipe holds 64 kB"
        os.set_blocking(reading, True)
        lines = []
        while not any("lost" in line for line in lines):  # the next write says how many
            lines += os.read(reading, 1 << 20).decode().splitlines()
            writer.write("more\n")
        writer.write("last\n")
        text = read_all(reading)
        assert "last" in text
        lost = next(line for line in lines if "lost" in line)
        assert 0 < int(lost.split()[1]) < 10_000
    os.close(reading)


def test_a_pipe_that_is_closed_is_no_error():
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w") as stream:
        writer = Writer(stream)
        for _ in range(3):
            writer.write("nobody\n")
            writer.drain(5.0)
        start_s = time.monotonic()
        writer.drain(5.0)
        assert time.monotonic() - start_s < 4.0
        assert module.LIMIT_BYTES > 0
