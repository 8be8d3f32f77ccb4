"""What `pyproject.toml` cannot say: where the injector is installed.

In a checkout it is a package of its own, which shares nothing with what it tests. A wheel has one
package at its top, so there it lies within `hilserver.scenarios`, which imports it from there.
"""

import sys

from setuptools import find_namespace_packages, setup

is_editable = "editable_wheel" in sys.argv
injector = ("" if is_editable else "hilserver.scenarios.installed.") + "hilserver_injector"
setup(
    packages=[*find_namespace_packages(include=["hilserver", "hilserver.*"]), injector],
    package_dir={injector: "tests/injector/hilserver_injector"},
)
