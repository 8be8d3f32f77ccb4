"""The pieces of a step call together what the step calls, each a part of it."""

import ast
from collections import Counter

from hilserver.kernel.pieces import pieces

STEP = """
from hilserver.compiled import kernel

AT = 3

@kernel(STEP_SIGNATURE)
def step(phase, tick, planned_ns, values, words):
    if phase == LATCH:
        request = phases.requested(words)
        tick = phases.latch(request, tick, planned_ns, AT, values, words)
        return tick
    if phase == PUBLISH:
        fitted.flag_unfitted(44528, values, words)
        return phases.publish(tick, planned_ns, AT, values, words)
    if phase == 0:  # slice 'sensors'
        parts.imu(AT, values, words)
        parts.tof(AT, values, words)
        return 0
    return 0
"""


def calls(source):
    return Counter(
        ast.unparse(node) for node in ast.walk(ast.parse(source)) if is_call(node)
    )


def is_call(node):
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)


def test_every_call_is_in_one_piece():
    found = pieces(STEP)
    assert len(found) == 5
    assert sum(map(calls, found), Counter()) == calls(STEP)


def test_a_piece_is_not_kept_and_keeps_what_the_step_knows():
    for piece in pieces(STEP):
        assert "@kernel(STEP_SIGNATURE, cache=False)" in piece
        assert "AT = 3" in piece


def test_what_uses_a_result_stays_with_it():
    [latch] = [piece for piece in pieces(STEP) if "phases.latch" in piece]
    assert "request = phases.requested(words)" in latch
