"""Recordings of real machines, which are no part of the project."""

import os
from pathlib import Path

import pytest


def recording(folder: str) -> Path:
    """Return the folder of a recording in HIL_DATA_DIR, or skip with a word on what is missing."""
    root = os.environ.get("HIL_DATA_DIR")
    if not root:
        pytest.skip(
            "no recordings: HIL_DATA_DIR is not set and ../shared/data does not exist"
        )
    path = Path(root) / folder
    if not path.is_dir():
        pytest.skip(f"HIL_DATA_DIR has no folder {folder}")
    return path
