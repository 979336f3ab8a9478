"""Generate PlanSys2's messages from the definitions beside this file, and compile them for this environment's Python.

Only the parts that Python and Fast DDS need, the type supports of C, in one shared object. All definitions are compiled
as one text each for C and C++, as the headers take most of the time.
"""

import subprocess
import sys
import sysconfig
from pathlib import Path

PREFIX = Path(sys.prefix)
PACKAGE = "plansys2_msgs"
SOURCES = Path(__file__).parent / PACKAGE
TYPE_SUPPORTS = ("rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c")
INTROSPECTION = PREFIX / "introspection" / PACKAGE
"""The directory of sources whose names would clash."""

DEPENDENCIES = ("std_msgs", "builtin_interfaces", "service_msgs")
LIBRARIES = (
    "rosidl_runtime_c",
    "rosidl_typesupport_c",
    *TYPE_SUPPORTS,
    "rosidl_typesupport_fastrtps_cpp",
    "rosidl_dynamic_typesupport",
    "fastcdr",
    "rmw",
    "rcutils",
)


def generate(target):
    """Write the sources of the package: C, Python, and the type supports."""
    from rosidl_cli.command.translate.api import translate
    from rosidl_generator_c.cli import GenerateC
    from rosidl_generator_py.cli import GeneratePython
    from rosidl_typesupport_c.cli import GenerateCTypesupport
    from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
    from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport

    shared = [str(PREFIX / "share")]
    files = [f"{SOURCES}:{path.relative_to(SOURCES)}" for path in sorted(SOURCES.glob("*/*.*"))]
    described = translate(
        package_name=PACKAGE,
        interface_files=files,
        include_paths=shared,
        output_format="idl",
        output_path=target / "idl",
    )
    for generator, place in (
        (GenerateC("c"), target),
        (GeneratePython("py", typesupport_implementations=["rosidl_typesupport_c"]), target),
        (GenerateCTypesupport("c", typesupport_implementations=TYPE_SUPPORTS), target),
        (GenerateFastRTPSCTypesupport("fastrtps_c"), target),
        (GenerateIntrospectionCTypesupport("introspection_c"), INTROSPECTION),
    ):
        generator.generate(PACKAGE, [*map(str, described)], shared, place)
    (target / "__init__.py").touch()


def compile_all(target):
    """Compile the sources into the module that the generated Python imports."""
    import numpy

    objects = target / "objects"
    objects.mkdir(exist_ok=True)
    included = [
        target.parent,
        INTROSPECTION.parent,
        PREFIX / "include",
        sysconfig.get_path("include"),
        numpy.get_include(),
    ]
    included += [path for path in (PREFIX / "include").iterdir() if path.is_dir()]
    flags = ["-O0", "-fPIC", "-w", *(f"-I{path}" for path in included)]
    c = [*target.rglob("*__functions.c"), *target.rglob("detail/*__type_support.c"), *target.rglob("_*_s.c")]
    c += INTROSPECTION.rglob("*__type_support.c")
    c.append(target / f"_{PACKAGE}_s.ep.rosidl_typesupport_c.c")
    cpp = [*target.rglob("*__type_support_c.cpp"), *target.rglob("*__type_support.cpp")]
    for name, parts in (("all.c", c), ("all.cpp", cpp)):
        (objects / name).write_text("".join(f'#include "{part}"\n' for part in parts))
    # each of these has statics of the same names
    run("gcc", *flags, "-c", "all.c", *target.rglob("*__description.c"), cwd=objects)
    run("g++", *flags, "-c", "all.cpp", "-o", "all_cpp.o", cwd=objects)
    generated = (
        "generator_c",
        "typesupport_c",
        "typesupport_fastrtps_c",
        "typesupport_introspection_c",
        "generator_py",
    )
    names = [*(f"{package}__rosidl_{kind}" for package in DEPENDENCIES for kind in generated), *LIBRARIES]
    module = target / f"{PACKAGE}_s__rosidl_typesupport_c{sysconfig.get_config_var('EXT_SUFFIX')}"
    libraries = [f"-L{PREFIX / 'lib'}", f"-Wl,-rpath,{PREFIX / 'lib'}", *(f"-l{name}" for name in names)]
    run("g++", "-shared", "-o", module, *objects.glob("*.o"), *libraries, cwd=objects)
    for name in TYPE_SUPPORTS:
        # the name by which ROS looks for it
        link = PREFIX / "lib" / f"lib{PACKAGE}__{name}.so"
        link.unlink(missing_ok=True)
        link.symlink_to(module)


def run(*command, cwd):
    subprocess.run([str(part) for part in command], cwd=cwd, check=True)


if __name__ == "__main__":
    place = Path(sysconfig.get_path("purelib")) / PACKAGE
    generate(place)
    compile_all(place)
