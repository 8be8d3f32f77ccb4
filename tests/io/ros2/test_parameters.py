"""The parameters as those of a ROS 2 node: what `ros2 param` asks for, and what comes back."""

import math
import struct

import numpy as np
import pytest

from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.builder import build
from hilserver.io.ros2.parameters import (
    BOOL,
    DOUBLE,
    INTEGER,
    NOT_SET,
    STRING,
    ParameterServices,
)
from hilserver.parameters import PLANT
from hilserver.ros.types import known_types
from tests.io.ros2.rig import PATIENCE_S, Host, robot
from tests.loopback.rig import wait_until

TYPES = known_types()
GUID = 0x0123456789ABCDEF


def value(kind, number=0.0):
    return TYPES.make(
        "rcl_interfaces/msg/ParameterValue",
        type=kind,
        bool_value=False,
        integer_value=int(number) if kind == INTEGER else 0,
        double_value=float(number) if kind == DOUBLE else 0.0,
        string_value="x",
        byte_array_value=np.zeros(0, np.uint8),
        bool_array_value=np.zeros(0, np.bool_),
        integer_array_value=np.zeros(0, np.int64),
        double_array_value=np.zeros(0),
        string_array_value=[],
    )


def parameters(**values):
    make = TYPES.make
    named = [
        make("rcl_interfaces/msg/Parameter", name=n, value=v) for n, v in values.items()
    ]
    return {"parameters": named}


class Asker:
    """Asks the services as a client does: by encoded messages."""

    def __init__(self, core, *, may_set=True):
        services = ParameterServices("ros2", core.parameters, TYPES, may_set=may_set)
        self._served = {
            served.name.rpartition("/")[2]: served for served in services.served()
        }
        self.parameters = core.parameters

    def __call__(self, service, **fields):
        served = self._served[service]
        request = TYPES.encode(TYPES.make(f"{served.type}_Request", **fields))
        values, answer = served.serve(
            None, TYPES.decode(request, f"{served.type}_Request")
        )
        assert values == {}
        return TYPES.decode(TYPES.encode(answer(True)), f"{served.type}_Response")


@pytest.fixture
async def ask(tmp_path):
    config = Config.model_validate({"scheduler": {"backend": "virtual"}})
    async with build(assemble_config(config, tmp_path)) as core:
        yield Asker(core)


async def test_set_acts_on_all_that_are_sound(ask):
    answer = ask(
        "set_parameters",
        **parameters(
            **{
                "plant.controller.k_p": value(INTEGER, 15),
                "terms.rotation_gain": value(DOUBLE, -0.3),
                "terms.setpoint_rate_limit": value(NOT_SET),
                "plant.max_rpm": value(STRING),
                "plant.maxrpm": value(DOUBLE, 1.0),
                "mechatronic.mass_kg": value(DOUBLE, 1.0),
            }
        ),
    )
    assert [r.successful for r in answer.results] == [
        True,
        True,
        True,
        False,
        False,
        False,
    ]
    assert [bool(r.reason) for r in answer.results] == [
        False,
        False,
        False,
        True,
        True,
        True,
    ]
    assert "needs a restart" in answer.results[-1].reason
    changed = {"plant.controller.k_p": 15.0, "terms.rotation_gain": -0.3}
    assert ask.parameters.differing == changed


async def test_k_om_by_name_and_a_flag_as_a_bool(ask):
    by_name = value(STRING)
    by_name.string_value = "tile"
    on = value(BOOL)
    on.bool_value = True
    wanted = {"kinematics.rotation_gain": by_name, "plant.exclusive_twist": on}
    answer = ask("set_parameters", **parameters(**wanted, **{"plant.max_rpm": on}))
    assert [r.successful for r in answer.results] == [True, True, False]
    assert ask.parameters.differing == {
        "kinematics.rotation_gain": 1.052,
        "plant.exclusive_twist": 1.0,
    }
    null = {"kinematics.rotation_gain": value(NOT_SET)}
    assert ask("set_parameters", **parameters(**null)).results[0].successful
    assert ask.parameters.differing == {"plant.exclusive_twist": 1.0}
    (about,) = ask(
        "describe_parameters", names=["kinematics.rotation_gain"]
    ).descriptors
    assert "by name printed_5_21 3.229, " in about.additional_constraints


async def test_the_robot_changes_only_if_that_is_granted(tmp_path):
    config = Config.model_validate({"scheduler": {"backend": "virtual"}})
    async with build(assemble_config(config, tmp_path)) as core:
        ask = Asker(core, may_set=False)
        both = parameters(**{"plant.max_rpm": value(DOUBLE, 70.0)})
        one = ask("set_parameters", **both).results[0]
        all_ = ask("set_parameters_atomically", **both).result
        assert not one.successful
        assert one.reason == all_.reason
        assert "ros2.grants: [parameters]" in one.reason
        assert core.parameters.differing == {}
        assert (
            ask("get_parameters", names=["plant.max_rpm"]).values[0].double_value
            == 90.0
        )


async def test_atomically_is_all_or_nothing(ask):
    wrong = {
        "plant.max_rpm": value(DOUBLE, 70.0),
        "plant.track_m": value(DOUBLE, math.nan),
    }
    answer = ask("set_parameters_atomically", **parameters(**wrong))
    assert (answer.result.successful, ask.parameters.differing) == (False, {})
    right = {"plant.max_rpm": value(DOUBLE, 70.0), "plant.track_m": value(DOUBLE, 0.3)}
    assert ask("set_parameters_atomically", **parameters(**right)).result.successful
    assert ask.parameters.differing == {"plant.max_rpm": 70.0, "plant.track_m": 0.3}


async def test_list_get_and_describe(ask):
    names = ask("list_parameters", prefixes=[], depth=0).result.names
    assert names == list(PLANT)
    below = ask("list_parameters", prefixes=["plant.controller"], depth=1).result
    assert set(below.names) == {n for n in PLANT if n.startswith("plant.controller.")}
    assert below.prefixes == ["plant.controller"]
    values = ask("get_parameters", names=[*names, "bogus"]).values
    assert values[-1].type == NOT_SET
    assert [v.double_value for v in values[:-1]] == pytest.approx(
        list(ask.parameters.values.values()), nan_ok=True
    )
    assert ask(
        "get_parameter_types", names=["plant.max_rpm", "bogus"]
    ).types.tolist() == [
        DOUBLE,
        NOT_SET,
    ]
    for descriptor in ask("describe_parameters", names=names).descriptors:
        parameter = PLANT[descriptor.name]
        (bounds,) = descriptor.floating_point_range
        assert (bounds.from_value, bounds.to_value) == (parameter.low, parameter.high)
        assert descriptor.read_only == (parameter.when == "restart")


async def test_a_node_of_another_implementation_sets_and_gets(cyclone, domain):
    service = "rcl_interfaces/srv/SetParameters"
    call, reply = (
        "rq/hilserver/set_parametersRequest",
        "rr/hilserver/set_parametersReply",
    )
    host = Host(
        cyclone,
        domain,
        ("w", call, f"{service}_Request", "reliable"),
        ("r", reply, f"{service}_Response", "reliable"),
    )
    request = TYPES.make(
        f"{service}_Request", **parameters(**{"plant.max_rpm": value(DOUBLE, 70.0)})
    )
    cdr = TYPES.encode(request)
    async with robot(domain, rmw="cyclonedds") as daemon, host:

        def is_answered():
            host.write_cdr(call, cdr[:4] + struct.pack("<Qq", GUID, 7) + cdr[4:])
            return bool(host.received[reply])

        await wait_until(is_answered, PATIENCE_S)
        answer = host.received[reply][0]
        assert struct.unpack_from("<Qq", answer, 4) == (GUID, 7)
        (result,) = TYPES.decode(
            answer[:4] + answer[20:], f"{service}_Response"
        ).results
        assert (result.successful, result.reason) == (True, "")
        assert daemon.core.parameters.differing == {"plant.max_rpm": 70.0}
