"""What `make run` starts, seen by a client of another make: the robot drives an eight."""

import itertools
import json
import math
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from hilserver.controller.path import Eight
from tests.commands.test_cli import write_config
from tests.helpers.daemons import announced

CLIENT = Path(__file__).parents[1] / "foreign_client"
WATCH_S = 400.0
"""A lap takes 26 s, and the client ends with it."""

pytestmark = pytest.mark.node_red


def distance_to(eight, x, y):
    points = (eight.point_m(2 * math.pi * i / 720) for i in range(720))
    return min(math.hypot(x - px, y - py) for px, py in points)


@pytest.fixture
def demo(tmp_path):
    command = [sys.executable, "-m", "hilserver", "run", "--demo"]
    command += ["-c", str(write_config(tmp_path))]
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, cwd=tmp_path
    ) as process:
        for line in process.stderr:
            if started := announced([line]):
                break
        yield process, started["opcua"]
        process.kill()


def test_a_foreign_client_sees_an_eight_takes_control_and_drives(demo):
    process, endpoint = demo
    node = shutil.which("node")
    assert node, "Node.js 20 is needed (make test installs its packages)"
    eight = Eight()
    end_m = 0.8 * eight.half_width_m
    watch = subprocess.run(
        [node, "watch_demo.cjs", endpoint, str(WATCH_S), str(end_m), "40"],
        cwd=CLIENT,
        capture_output=True,
        text=True,
        timeout=WATCH_S + 200,
        check=False,
    )
    assert watch.returncode == 0, watch.stderr
    # node-opcua warns before it
    seen = json.loads(watch.stdout.strip().splitlines()[-1])
    poses = seen["poses"]
    off_m = max(distance_to(eight, x, y) for x, y, _ in poses[50:])
    assert off_m < 0.5, "more than a controller that a busy computer held up"
    xs = [x for x, _, _ in poses]
    assert min(xs) < -end_m
    assert max(xs) > end_m
    turns = [b - a for (_, _, a), (_, _, b) in itertools.pairwise(poses)]
    wrapped = [math.remainder(turn, 2 * math.pi) for turn in turns]
    assert max(wrapped) > 0.02, "no left turn"
    assert min(wrapped) < -0.02, "no right turn"
    assert (seen["control"], seen["written"]) == ("Good", "Good")
    assert seen["setpoints"] == [40, 40, -40, -40]
    assert seen["speeds"] == pytest.approx(seen["setpoints"], abs=0.5)
    process.send_signal(signal.SIGINT)
    rest = process.stderr.read()
    assert process.wait(600) == 0
    assert "Traceback" not in rest
