"""Machines that hilserver cannot simulate, recognised by the names and types in their logs."""

import re
from collections.abc import Collection
from typing import Final, NamedTuple

from hilserver.errors import LogError
from hilserver.measured.proposal import words_of


class _Kind(NamedTuple):
    what: str
    words: frozenset[str]
    types: re.Pattern[str]
    fewest: int = 1  # names that have to show it
    may_have_wheels: bool = False


_KINDS: Final = (
    _Kind(
        "steers its wheels, as cars and tricycles do",
        frozenset({"steer", "steering", "ackermann"}),
        re.compile(r"ackermann_msgs/"),
        may_have_wheels=True,
    ),
    _Kind(
        "flies",
        frozenset(
            {"thrust", "rotor", "rotors", "propeller", "quadrotor", "quadcopter"}
        ),
        re.compile(r"(px4_msgs|mav_msgs)/|mavros_msgs/(msg/)?(AttitudeTarget|Thrust)"),
    ),
    _Kind(
        "is an arm",
        frozenset({"shoulder", "elbow", "wrist", "gripper", "panda", "forearm"}),
        re.compile(r"franka_msgs/|control_msgs/.*Gripper"),
        fewest=2,
    ),
)
_JOINT: Final = re.compile(r"(?i)(?<![a-z])joint_?[a-z]?(\d)(?!\d)")
_FEWEST_JOINTS: Final = 5  # numbered ones, of which none is a wheel's


def refuse_other_machine(
    where: str, names: Collection[str], types: Collection[str], *, has_wheels: bool
) -> None:
    """Refuse the log of a machine that does not steer by the speeds of its wheels.

    Parameters
    ----------
    names : collection of str
        Columns, or topics and their fields, that hold something which changes.
    has_wheels : bool
        Whether the speeds or angles of wheels on both sides are among them.
    """
    for kind in _KINDS:
        shown = [name for name in names if kind.words & words_of(name)]
        typed = [name for name in types if kind.types.match(name)]
        is_shown = typed or len(shown) >= kind.fewest
        may_be = kind.may_have_wheels or not has_wheels
        if is_shown and may_be:
            raise _refusal(where, (typed + shown)[0], kind.what)
    joints = {match[1]: name for name in names if (match := _JOINT.search(name))}
    if len(joints) >= _FEWEST_JOINTS and not has_wheels:
        raise _refusal(where, min(joints.values()), "is an arm")


def _refusal(where: str, name: str, what: str) -> LogError:
    return LogError(
        f"{where}: '{name:.60}' says that this machine {what}; hilserver simulates robots that"
        " steer by the speeds of their wheels (skid steering, differential drive, mecanum) and"
        " cannot simulate it: if it is one of these, write a mapping by hand"
    )
