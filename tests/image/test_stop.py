"""Stop from outside: what is no image of ours is not written to."""

import pytest

from hilserver.errors import FailedError
from hilserver.image import press_stop
from hilserver.image.layout import MAGIC
from hilserver.image.shared_file import path_of
from tests.fakes import image_name, make_image


def test_a_press_is_in_force_until_it_is_acknowledged():
    image = make_image()
    try:
        first = press_stop(image.name)
        assert image.control.stop_request == first != image.control.stop_acknowledged
        assert press_stop(image.name) > first
    finally:
        image.close()


def test_an_image_that_is_not_there_is_named():
    with pytest.raises(FailedError, match="no such file"):
        press_stop(image_name())


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "not complete"),
        (bytes(4096), "another hilserver version"),
        (MAGIC.to_bytes(8, "little") + bytes(4088), "another hilserver version"),
    ],
)
def test_what_is_no_image_is_left_as_it_is(content, why):
    path = path_of(image_name())
    path.write_bytes(content)
    try:
        with pytest.raises(FailedError, match=why):
            press_stop(path.name.removeprefix("hilserver-"))
        assert path.read_bytes() == content
    finally:
        path.unlink()
