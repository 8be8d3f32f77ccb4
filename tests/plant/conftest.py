"""One compiled robot for all tests of the plant."""

import pytest

from hilserver.plant.reference.library import build
from tests.plant.rig import Rig


@pytest.fixture
def rig():
    return Rig()


@pytest.fixture(scope="session")
def c_library(tmp_path_factory):
    return build(tmp_path_factory.mktemp("c_reference"))
