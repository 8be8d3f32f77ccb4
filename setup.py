"""What `pyproject.toml` cannot say: files from outside the package, and compiled code in a wheel.

In a checkout the injector is a package of its own, which shares nothing with what it tests. A wheel
has one package at its top, so there it lies within `hilserver.scenarios`, which imports it from
there. So do the scenarios of ``examples/thesis``, which `hilserver.experiment` drives.

``make wheel`` names a folder of compiled code in HILSERVER_OBJECTS; the wheel is then one for this
interpreter and architecture. Without it the wheel is for all of them, and compiles at its first
start.
"""

import json
import os
import shutil
import sys
from pathlib import Path

from setuptools import Distribution, find_namespace_packages, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_py import build_py

is_editable = "editable_wheel" in sys.argv
injector = (
    "" if is_editable else "hilserver.scenarios.installed."
) + "hilserver_injector"
objects = os.environ.get("HILSERVER_OBJECTS") if "bdist_wheel" in sys.argv else None


class WithObjects(Distribution):
    """A distribution with machine code in it."""

    def has_ext_modules(self) -> bool:
        """Return that it has: it is no wheel for every interpreter."""
        return True


class CopyObjects(build_py):
    """Puts the compiled code beside what reads it."""

    def run(self) -> None:
        """Copy all."""
        super().run()
        inside = Path(self.build_lib) / "hilserver" / "compiled" / "objects"
        shutil.rmtree(inside, ignore_errors=True)
        shutil.copytree(objects, inside)


class Tagged(bdist_wheel):
    """Names the platform, and adds the terms of numba, of which the compiled code has parts."""

    def get_tag(self) -> tuple[str, str, str]:
        """Return interpreter, its interface, and the platforms of numba's own wheel."""
        interpreter, interface, _ = super().get_tag()
        made_with = json.loads(
            (Path(objects) / "made_with.json").read_text(encoding="utf-8")
        )
        return interpreter, interface, made_with["platform"]

    def write_wheelfile(self, folder: str, *words: str, **named: str) -> None:
        """Write what the wheel says of itself."""
        super().write_wheelfile(folder, *words, **named)
        inside = Path(folder) / "licenses"
        inside.mkdir(exist_ok=True)
        shutil.copy(Path(objects) / "LICENSE.numba", inside)
        about = Path(folder) / "METADATA"
        text = about.read_text(encoding="utf-8")
        line = "License-File: LICENSE\n"
        about.write_text(
            text.replace(line, f"{line}License-File: LICENSE.numba\n", 1), "utf-8"
        )


with_objects = {
    "distclass": WithObjects,
    "cmdclass": {"build_py": CopyObjects, "bdist_wheel": Tagged},
}
beside = {injector: "tests/injector/hilserver_injector"}
if not is_editable:
    beside["hilserver.experiment.drives"] = "examples/thesis"
setup(
    packages=[*find_namespace_packages(include=["hilserver", "hilserver.*"]), *beside],
    package_dir=beside,
    **(with_objects if objects else {}),
)
