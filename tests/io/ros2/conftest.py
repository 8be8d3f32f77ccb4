import pytest

from benchmarks.ros2_peers import build_cyclone, build_fast_dds
from hilserver.ros.flavours import FLAVOURS
from tests.helpers.shared import made_once
from tests.io.ros2 import rig


@pytest.fixture(scope="session")
def fast_dds(tmp_path_factory):
    return made_once(tmp_path_factory, "fast_dds", build_fast_dds)


@pytest.fixture(scope="session")
def cyclone(tmp_path_factory):
    types: set[str] = set()
    for flavour in FLAVOURS.values():
        topics = (*flavour.published, *flavour.extras.values(), *flavour.subscribed)
        types |= {topic.type for topic in topics}
        types |= {
            f"{s.type}_{part}"
            for s in flavour.served
            for part in ("Request", "Response")
        }
    for service in (
        "SetParameters",
        "GetParameters",
        "ListParameters",
        "DescribeParameters",
    ):
        types |= {
            f"rcl_interfaces/srv/{service}_{part}" for part in ("Request", "Response")
        }
    return made_once(
        tmp_path_factory, "cyclone", lambda folder: build_cyclone(folder, types)
    )


@pytest.fixture(params=["fast_dds", "cyclone"])
def peer(request):
    """Either of the two DDS implementations that others have written."""
    return request.getfixturevalue(request.param)


@pytest.fixture
def domain():
    with rig.claimed_domain() as number:
        yield number
