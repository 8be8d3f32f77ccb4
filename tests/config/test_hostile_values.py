"""Values that were taken although they make no sense, or ended in a traceback."""

from pathlib import Path

import pytest

from hilserver.config.hall import load_hall
from hilserver.config.loading import load
from hilserver.config.root import Config
from hilserver.errors import ConfigError
from hilserver.plant.errors import PlantError


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (
            "plant:\n  wheel_radius_m: 1e-320\n",
            r":2: plant\.wheel_radius_m: 1e-320 is not valid",
        ),
        ("control:\n  command_timeout_ms: 12:30:00\n", ":2: .*12:30:00.*base-60"),
        ("scheduler:\n  slices: {plannt: 1}\n", ":2: .*'plannt' looks like 'plant'"),
        ("scheduler:\n  slices: {publsh: 20}\n", ":2: .*'publsh' looks like 'publish'"),
    ],
)
def test_refused_with_line_and_remedy(tmp_path: Path, text: str, sentence: str) -> None:
    path = tmp_path / "config.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=sentence):
        load(path, Config)


def test_a_hall_whose_name_is_no_path_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(PlantError, match="cannot be read"):
        load_hall("\0", tmp_path)
