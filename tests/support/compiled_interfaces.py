"""A real, compiled ROS interface package, made with ROS's own generators and the compiler of this host.

Run as `python compiled_interfaces.py FOLDER PACKAGE DEPENDENCIES...`, with a JSON object of definitions, such as
{"msg/Name": ["line", ...]}, on standard input. Knows nothing of the package: what it makes is the independent
counterpart of classes made at run time. One shared library is all that ROS looks for: the type supports for Fast DDS
and for introspection, which the stock dispatcher finds by their names on LD_LIBRARY_PATH, and the extension that the
generated Python classes import.
"""

import json
import os
import subprocess
import sys
import sysconfig
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

PREFIX = Path(sys.prefix)
SHARE = PREFIX / "share"
SUPPORTS = ("rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c")
LIBRARIES = ("rosidl_runtime_c", "rosidl_typesupport_c", *SUPPORTS, "rmw", "fastcdr")
OF_A_PACKAGE = ("rosidl_generator_c", "rosidl_generator_py", *SUPPORTS)


def missing():
    """Return why nothing can be compiled here, None when it can."""
    import shutil

    if shutil.which("gcc") is None or shutil.which("g++") is None:
        return "gcc and g++ are needed: apt install build-essential"
    if not Path(sysconfig.get_paths()["include"], "Python.h").exists():
        return "the headers of this Python are needed: apt install python3-dev"
    return None


def make(folder, package, definitions, dependencies):
    """Generate and compile a package; `folder` is then what PYTHONPATH and LD_LIBRARY_PATH need."""
    generated = folder / "generated" / package
    idls = list(_adapt(generated / "idl", package, definitions))
    base = {
        "package_name": package,
        "idl_tuples": [f"{generated / 'idl'}:{idl}" for idl in idls],
        "ros_interface_files": [str(generated / "idl" / idl) for idl in idls],
        "target_dependencies": [],
    }
    include = [f"{dependency}:{SHARE / dependency}" for dependency in dependencies]
    hashes = generated / "hash"
    _run("rosidl_generator_type_description", "generate_type_hash", base, hashes, include_paths=include)
    base["type_description_tuples"] = [f"{idl}:{hashes / Path(idl).with_suffix('.json')}" for idl in idls]
    source = generated / "src" / package
    _run("rosidl_generator_c", "generate_c", base, source)
    _run(SUPPORTS[0], "generate_typesupport_fastrtps_c", base, source)
    _run(SUPPORTS[1], "generate_c", base, generated / "introspection" / package)
    _run("rosidl_typesupport_c", "generate_c", base, generated / "dispatch" / package, list(SUPPORTS))
    _run("rosidl_generator_py", "generate_py", base, folder / package, ["rosidl_typesupport_c"])
    _visibility(source, package)
    _visibility(generated / "introspection" / package, package)
    _compile(folder, package, generated, dependencies)


def _adapt(folder, package, definitions):
    """Write the definitions as ROS has them, and as IDL; yields the latter's paths."""
    from rosidl_adapter.msg import convert_msg_to_idl
    from rosidl_adapter.srv import convert_srv_to_idl

    for name, lines in definitions.items():
        kind = name.split("/")[0]
        path = Path(f"{name}.{kind}")
        (folder / kind).mkdir(parents=True, exist_ok=True)
        (folder / path).write_text("\n".join(lines) + "\n")
        convert = {"msg": convert_msg_to_idl, "srv": convert_srv_to_idl}[kind]
        convert(folder, package, path, folder / kind)
        yield str(path.with_suffix(".idl"))


def _run(module, function, base, output, *arguments, **more):
    """Call one of ROS's generators."""
    output.mkdir(parents=True, exist_ok=True)
    path = output / "arguments.json"
    templates = str(SHARE / module / "resource")
    path.write_text(json.dumps({**base, "output_dir": str(output), "template_dir": templates, **more}))
    getattr(__import__(module), function)(str(path), *arguments)


def _visibility(source, package):
    """Write the headers that CMake would configure; they say nothing where symbols are visible anyway."""
    upper = package.upper()
    for kind in ("rosidl_generator_c", *SUPPORTS):
        names = [f"{mark}_{which}_{package}" for mark in (kind.upper(),) for which in ("PUBLIC", "EXPORT", "IMPORT")]
        header = source / "msg" / f"{kind}__visibility_control.h"
        header.parent.mkdir(parents=True, exist_ok=True)
        header.write_text(
            f"#ifndef {upper}_{kind}\n#define {upper}_{kind}\n"
            + "".join(f"#define {name}\n" for name in names)
            + "#endif\n"
        )


def _compile(folder, package, generated, dependencies):
    import numpy

    includes = [generated / "src", generated / "introspection", sysconfig.get_paths()["include"], numpy.get_include()]
    includes += [PREFIX / "include", *(path for path in (PREFIX / "include").iterdir() if path.is_dir())]
    flags = ["-O0", "-fPIC", "-w", *(f"-I{include}" for include in includes)]
    sources = sorted([*generated.rglob("*.c"), *generated.rglob("*.cpp"), *(folder / package).rglob("*.c")])
    objects = [folder / f"{number}.o" for number in range(len(sources))]

    def compile_file(source, target):
        compiler = ["gcc"] if source.suffix == ".c" else ["g++", "-std=c++17"]
        subprocess.run([*compiler, "-c", *flags, str(source), "-o", str(target)], check=True)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(compile_file, sources, objects))
    libraries = [f"{dependency}__{kind}" for dependency in dependencies for kind in OF_A_PACKAGE]
    library = folder / f"lib{package}__{SUPPORTS[0]}.so"
    subprocess.run(
        ["g++", "-shared", *map(str, objects), "-o", str(library), f"-L{PREFIX / 'lib'}", "-Wl,--allow-shlib-undefined",
         *(f"-l{library}" for library in (*libraries, *LIBRARIES))],
        check=True,
    )  # fmt: skip
    for file in objects:
        file.unlink()
    (folder / f"lib{package}__{SUPPORTS[1]}.so").symlink_to(library.name)
    suffix = sysconfig.get_config_var("EXT_SUFFIX")
    (folder / package / f"{package}_s__rosidl_typesupport_c{suffix}").symlink_to(library)


if __name__ == "__main__":
    make(Path(sys.argv[1]), sys.argv[2], json.load(sys.stdin), sys.argv[3:])
