"""EduArt's RotationSpeed for a real ROS 2: made and compiled as a workspace on the robot does it.

Run by the Python of a ROS 2, it writes the sources of the message; `build` also compiles them, so
that `iotbot_interface.msg` can be imported in the environment that it returns.
"""

import importlib
import os
import subprocess
import sys
from pathlib import Path

PACKAGE = "iotbot_interface"
IDL = """module iotbot_interface { module msg { struct RotationSpeed {
  float front_left_rpm; float front_right_rpm; float rear_left_rpm; float rear_right_rpm;
}; }; };
"""
GENERATORS = {
    "rosidl_generator_c": "GenerateC",
    "rosidl_generator_cpp": "GenerateCpp",
    "rosidl_generator_py": "GeneratePython",
    "rosidl_typesupport_c": "GenerateCTypesupport",
    "rosidl_typesupport_fastrtps_c": "GenerateFastRTPSCTypesupport",
    "rosidl_typesupport_fastrtps_cpp": "GenerateFastRTPSCppTypesupport",
}
SUPPORT = "rosidl_typesupport_c"
NAMES = ("rosidl_generator_c", "rosidl_generator_py", *list(GENERATORS)[3:])
"""Ends of the names under which ROS loads parts of the library; here one has all of them."""
LIBRARIES = (
    "rosidl_runtime_c", "rcutils", "rosidl_typesupport_c", "rosidl_typesupport_fastrtps_c",
    "rosidl_typesupport_fastrtps_cpp", "fastcdr",
)  # fmt: skip


def write_sources(folder: Path) -> None:
    """Write the sources of the message; needs the generators of a ROS 2."""
    source = folder / "source"
    (source / "msg").mkdir(parents=True)
    (source / "msg" / "RotationSpeed.idl").write_text(IDL)
    for module, name in GENERATORS.items():
        generator = getattr(importlib.import_module(f"{module}.cli"), name)
        more = (
            {"typesupport_implementations": [SUPPORT]} if module.endswith("_py") else {}
        )
        generator(name, **more).generate(
            package_name=PACKAGE,
            interface_files=[f"{source}:msg/RotationSpeed.idl"],
            include_paths=[],
            output_path=folder / PACKAGE,
        )


def build(folder: Path, python: Path) -> dict[str, str]:
    """Make the package below a folder; return the variables by which a node finds it."""
    ros = python.parents[1]
    found = {"AMENT_PREFIX_PATH": str(ros), "PYTHONPATH": str(folder)}
    subprocess.run(
        [python, __file__, folder],
        check=True,
        env=os.environ | found,
        capture_output=True,
    )
    ask = "import sysconfig, numpy; print(sysconfig.get_path('include'), numpy.get_include())"
    asked = subprocess.run(
        [python, "-c", ask], check=True, capture_output=True, text=True
    )
    headers = [folder, *(ros / "include").iterdir(), *asked.stdout.split()]
    flags = ["-fPIC", "-shared", "-w", *(f"-I{path}" for path in headers)]
    links = [f"-L{ros}/lib", f"-L{folder}", f"-Wl,-rpath,{ros}/lib:{folder}"]
    links += [f"-l{name}" for name in LIBRARIES]
    package, detail = folder / PACKAGE, folder / PACKAGE / "msg" / "detail"
    parts = [detail / f"rotation_speed__{p}.c" for p in ("functions", "description")]
    parts += [detail / "rotation_speed__type_support.c"]
    objects = []
    for part in parts:
        objects.append(part.with_suffix(".o"))
        subprocess.run(
            ["cc", "-c", *flags[:1], *flags[2:], part, "-o", objects[-1]], check=True
        )
    parts = [
        *detail.rglob("*.cpp"),
        package / "msg" / "rotation_speed__type_support.cpp",
    ]
    library = folder / f"lib{PACKAGE}.so"
    subprocess.run(
        ["c++", "-std=c++17", *flags, *objects, *parts, "-o", library, *links],
        check=True,
    )
    for name in NAMES:
        (folder / f"lib{PACKAGE}__{name}.so").symlink_to(library)
    parts = [
        package / f"_{PACKAGE}_s.ep.{SUPPORT}.c",
        package / "msg" / "_rotation_speed_s.c",
    ]
    extension = package / f"{PACKAGE}_s__{SUPPORT}.so"
    command = ["cc", *flags, *parts, "-o", extension, *links, f"-l{PACKAGE}"]
    subprocess.run(command, check=True)
    (package / "__init__.py").touch()
    return found | {"LD_LIBRARY_PATH": str(folder)}


if __name__ == "__main__":
    write_sources(Path(sys.argv[1]))
