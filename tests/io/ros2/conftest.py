import pytest

from tests.io.ros2 import rig


@pytest.fixture(scope="session")
def fast_dds(tmp_path_factory):
    return rig.build(tmp_path_factory.mktemp("fast_dds"))


@pytest.fixture
def domain():
    with rig.claimed_domain() as number:
        yield number
