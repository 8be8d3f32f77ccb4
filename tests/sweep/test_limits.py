"""What a controller prints goes nowhere, however blocks overlap and whatever it keeps."""

import contextlib
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

from hilserver.sweep.limits import limited


def overlap():
    first, second = contextlib.ExitStack(), contextlib.ExitStack()
    first.enter_context(limited(60.0))
    second.enter_context(limited(60.0))
    first.close()
    second.close()


def test_blocks_that_overlap_leave_an_open_output(monkeypatch):
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, getattr(sys, name))
    with ThreadPoolExecutor(1) as pool:  # as the threads of a Dask worker do
        pool.submit(overlap).result()
    for stream in (sys.stdout, sys.stderr):
        print("still here", file=stream, flush=True)


def test_an_output_that_a_controller_keeps_serves_for_the_next_machine(capsys):
    with limited(60.0):
        kept = sys.stdout
    with limited(60.0):
        print("still here", file=kept, flush=True)
        print("and here", file=sys.stderr, flush=True)
    assert capsys.readouterr() == ("", "")


def test_a_process_ends_without_a_warning_of_an_open_file():
    command = [sys.executable, "-W", "always", "-c", "import hilserver.sweep.limits"]
    ended = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "ResourceWarning" not in ended.stderr
