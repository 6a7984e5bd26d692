"""Allowed imports between subpackages. The table is the architecture; this test checks it."""

import ast
import functools
import re
import sys
from pathlib import Path

import pytest

PACKAGE = "canopen_control"
ROOT = Path(__file__).parents[1] / PACKAGE
STDLIB = frozenset(sys.stdlib_module_names)
PURE = frozenset(
    """__future__ abc binascii bisect collections contextlib copy dataclasses datetime difflib enum functools heapq
    itertools math operator pathlib re string struct types typing""".split()  # noqa: SIM905 - one name a line is not a list
)
MARKS = frozenset({"mypy_extensions"})  # what may be derived from where it is compiled
EVERYBODY = frozenset({"duration", "errors", "frame", "version"})
MESSAGES = "rpc.messages"  # of every socket: pure, for every subpackage

#: subpackage -> (subpackages it may import beside its own, modules from outside)
MAY_IMPORT = {
    "duration": (set(), PURE),
    "errors": (set(), PURE),
    "frame": (set(), PURE),
    "version": (set(), PURE | {"importlib"}),
    "data_files": (set(), PURE),
    "host": (set(), STDLIB),
    "rpc": ({"host", "cia301.emcy", "cia402.state"}, STDLIB | {"msgspec"}),  # a state and an error code have one text
    "yamlfile": ({"data_files"}, PURE | {"yaml", "os"}),
    "personality": ({"data_files", "yamlfile"}, PURE),  # of drives: what both sides of the wire know of manufacturers
    "urdf": ({"host.fork", "data_files"}, STDLIB | {"xacro", "ament_index_python"}),
    "od": ({"data_files"}, PURE | {"xml"}),
    "cia301": ({"od"}, PURE),
    "cia402": ({"od", "cia301"}, PURE),
    "profiles": ({"od"}, PURE),
    "bus": ({"host", "rpc"}, STDLIB | {"can"}),
    "master": ({"od", "cia301", "cia402", "profiles", "bus", "yamlfile", "data_files", "personality"}, STDLIB),
    "virtual": (
        {"od", "cia301", "cia402", "profiles", "bus", "host", "rpc", "yamlfile", "personality"},
        STDLIB | {"numpy"},
    ),
    "physics": ({"virtual", "urdf", "yamlfile", "rpc", "data_files"}, STDLIB | {"mujoco", "numpy"}),
    "hardware": ({"od", "cia301", "cia402", "profiles", "master", "yamlfile", "urdf"}, STDLIB | MARKS),
    "controllers": ({"cia301", "cia402", "hardware.interfaces", "urdf", "yamlfile"}, STDLIB | MARKS | {"numpy"}),
    "runtime": (
        {
            "od",
            "cia301",
            "cia402",
            "profiles",
            "bus",
            "host",
            "rpc",
            "master",
            "virtual",
            "physics",
            "hardware",
            "controllers",
            "yamlfile",
            "urdf",
            "data_files",
            "personality",
        },
        STDLIB | MARKS,
    ),
    "check": (
        {"od", "cia402", "bus", "host", "rpc", "master", "hardware", "controllers", "runtime", "yamlfile", "urdf"}
        | {"cia301", "physics"},
        STDLIB,
    ),
    "simulation": (  # the only subpackage that joins both sides of the wire
        {"od", "bus", "host", "rpc", "yamlfile", "master", "virtual", "hardware", "controllers", "runtime", "urdf"}
        | {"cia301", "cia402", "data_files", "check", "personality"},
        STDLIB | MARKS | {"distributed", "cloudpickle"},
    ),
    "commissioning": (
        # what values mean in words is the trace's to say; host.files keeps what a node held before it was written
        {"od", "cia301", "cia402", "profiles", "client", "host.files", "trace.values", "trace.network_description"}
        | {"trace.bag"},  # a scope's shot is a bag too
        STDLIB | {"numpy", "matplotlib"},
    ),
    "testing": ({"simulation", "runtime", "virtual", "master", "cia301", "commissioning"}, STDLIB | {"pytest"}),
    "scaffold": (
        {"od", "cia402", "profiles", "controllers", "master", "runtime", "check", "personality", "host.files"},
        STDLIB,
    ),
    "client": ({"host", "rpc", "yamlfile"}, STDLIB),  # files of what is sent
    "gateway": ({"cia301", "host"}, STDLIB),
    "conformance": ({"od", "bus", "host", "cia301", "cia402", "virtual"}, STDLIB),
    "calibration": ({"client", "controllers", "host.files", "rpc", "yamlfile", "data_files"}, STDLIB),
    "robot": ({"client", "rpc", "runtime", "od"}, STDLIB),  # the library: a client, of a runtime that it starts too
    "ros": ({"client", "host", "rpc", "urdf"}, None),
    "trace": (
        # what of ros is free of ROS: the numbers of its messages, for bags
        {
            "client",
            "host",
            "rpc",
            "bus",
            "od",
            "cia301",
            "cia402",
            "urdf",
            "ros.conversions",
            "ros.diagnosis",
            "ros.sample_topics",
            "ros.interfaces.definition",
        },
        STDLIB | {"rosbags", "numpy", "cantools"},
    ),
    "monitor": (
        {"client", "host", "rpc", "bus", "od", "cia301", "cia402", "trace", "commissioning"},
        STDLIB | {"textual", "rich"},
    ),
    # what is done at one node is the work of the subpackage commissioning; od and cia301 tell what it holds
    "view": (
        {"client", "host", "rpc", "urdf", "commissioning", "od", "cia301", "cia402.state"},
        STDLIB | {"nicegui", "fastapi", "starlette", "uvicorn"},
    ),
    "interop": ({"od", "bus", "client"}, STDLIB | {"canopen"}),
    "cli": (None, STDLIB | {"canopen_control_bench", "argcomplete"}),
}
#: the packages that only one subpackage may touch
ONLY = {
    "rclpy": "ros",
    "can": "bus",
    "msgspec": "rpc",
    "canopen": "interop",
    "yaml": "yamlfile",
    "xacro": "urdf",
    "mujoco": "physics",
    "distributed": "simulation",
    "cloudpickle": "simulation",
    "nicegui": "view",
    "fastapi": "view",
    "starlette": "view",
    "uvicorn": "view",
    "textual": "monitor",
    "rosbags": "trace",
    "cantools": "trace",
    "matplotlib": "commissioning",
    "canopen_control_bench": "cli",
    "argcomplete": "cli",
}


def modules():
    return sorted(
        path for path in ROOT.rglob("*.py") if path.name not in ("__main__.py",) and path.parent != ROOT / "data"
    )


def subpackage_of(path):
    return path.relative_to(ROOT).parts[0].removesuffix(".py")


def imported(path):
    """Return the dotted name of everything that is imported, annotations included."""
    names = imported_by(path.read_text(encoding="utf-8"))
    assert not any(name.startswith(".") for name in names), f"{path}: relative import"
    return names


@functools.cache
def imported_by(text):
    names = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names += [f"{'.' * node.level}{node.module or ''}.{alias.name}" for alias in node.names]
    return names


def forbidden(path):
    """Yield a sentence for each import of a module that its subpackage may not make."""
    subpackage = subpackage_of(path)
    if subpackage == "__init__":
        return
    assert subpackage in MAY_IMPORT, f"{subpackage} has no line in the table"
    ours, outside = MAY_IMPORT[subpackage]
    for name in imported(path):
        top, _, rest = name.partition(".")
        other = rest.split(".")[0]
        if top != PACKAGE:
            if outside is not None and top not in outside:
                yield f"{path.relative_to(ROOT)}: {subpackage} may not import {name}"
            elif ONLY.get(top, subpackage) != subpackage:
                yield f"{path.relative_to(ROOT)}: only {ONLY[top]} imports {top}"
        elif ours is None or other in {*EVERYBODY, *ours, subpackage, ""} or rest.startswith(MESSAGES):
            continue
        elif not any(rest.startswith(our + ".") or rest == our for our in ours):
            yield f"{path.relative_to(ROOT)}: {subpackage} may not import {rest}"


def test_imports_follow_the_layers():
    assert [sentence for path in modules() for sentence in forbidden(path)] == []


def test_master_and_virtual_drives_never_share_code_that_decides():
    for path in modules():
        if subpackage_of(path) == "virtual":
            assert not any(name.startswith((f"{PACKAGE}.master", f"{PACKAGE}.hardware")) for name in imported(path)), (
                path
            )


# -- who knows a controller or a component by its type

#: subpackage whose classes are told apart by what they declare -> the class that they derive from
DECLARED = {"controllers": "Controller", "hardware": "ComponentLifecycle"}


def derived(root, base):
    """Return the classes below `root` that derive from `base`, directly or not, base included."""
    parents = {
        node.name: {name for item in node.bases for name in names_in(item)}
        for path in root.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef)
    }
    result = {base}
    while more := {name for name, above in parents.items() if above & result} - result:
        result |= more
    return result


def names_in(node):
    """Yield the last word of every name in an expression."""
    for item in ast.walk(node):
        if isinstance(item, ast.Name):
            yield item.id
        elif isinstance(item, ast.Attribute):
            yield item.attr


def asked_for_its_type(path, classes):
    """Return the lines in which something is asked whether it is one of these classes."""
    text = path.read_text(encoding="utf-8")
    if classes.isdisjoint(re.findall(r"\w+", text)):  # most modules name none: reading them as code takes seconds
        return []
    return [
        node.lineno
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Call)
        and next(names_in(node.func), "") in ("isinstance", "issubclass")
        and classes & {name for argument in node.args[1:] for name in names_in(argument)}
    ]


@pytest.mark.parametrize("subpackage", DECLARED)
def test_only_its_subpackage_asks_a_controller_or_component_for_its_type(subpackage):
    classes = derived(ROOT / subpackage, DECLARED[subpackage])
    assert len(classes) > 3
    others = (path for path in modules() if subpackage_of(path) != subpackage)
    result = {str(path.relative_to(ROOT)): lines for path in others if (lines := asked_for_its_type(path, classes))}
    assert result == {}, f"let {DECLARED[subpackage]} declare what is asked here"


def test_a_question_for_a_type_would_be_seen(tmp_path):
    (tmp_path / "a.py").write_text("class Mine(base.Controller): pass\nclass Finer(Mine): pass\nclass Else: pass\n")
    classes = derived(tmp_path, "Controller")
    assert classes == {"Controller", "Mine", "Finer"}
    path = tmp_path / "b.py"
    path.write_text("isinstance(x, Else)\nisinstance(x, (int, other.Finer))\nany(issubclass(y, Mine) for y in z)\n")
    assert asked_for_its_type(path, classes) == [2, 3]


# -- cycles


def graph(root):
    """Return for each module of the package at `root` those it imports, those for its annotations included."""
    package = root.name
    paths = {}
    for path in root.rglob("*.py"):
        if path.parent != root / "data":
            name = ".".join((package, *path.relative_to(root).with_suffix("").parts))
            paths[name.removesuffix(".__init__")] = path
    return {module: {home(name, paths) for name in imported(path)} - {module, ""} for module, path in paths.items()}


def home(name, known):
    """Return the module of `known` that an imported name lives in, nothing for one from outside."""
    while name and name not in known:
        name = name.rpartition(".")[0]
    return name


def cycles(imports):
    """Return the strongly connected components of more than one module (Tarjan), each sorted."""
    number, low, stack, result = {}, {}, [], []

    def visit(module):
        number[module] = low[module] = len(number)
        stack.append(module)
        for other in imports[module]:
            if other not in number:
                visit(other)
                low[module] = min(low[module], low[other])
            elif other in stack:
                low[module] = min(low[module], number[other])
        if low[module] == number[module]:
            component = stack[stack.index(module) :]
            del stack[stack.index(module) :]
            if len(component) > 1:
                result.append(sorted(component))

    for module in sorted(imports):
        if module not in number:
            visit(module)
    return result


def test_no_modules_import_each_other_not_even_for_their_annotations():
    assert cycles(graph(ROOT)) == [], "these modules import each other; let the lower one say what it needs"


def test_a_cycle_would_be_seen_whatever_it_is_imported_for(tmp_path):
    root = tmp_path / "pkg"
    (root / "sub").mkdir(parents=True)
    for name, text in {
        "__init__": "",
        "sub/__init__": "from pkg.sub.a import A",
        "sub/a": "from pkg.sub import b",
        "sub/b": "if TYPE_CHECKING:\n    from pkg.sub.c import C",
        "sub/c": "def late():\n    import pkg.sub.a",
        "sub/d": "from pkg.sub.a import A\nimport socket",
    }.items():
        (root / f"{name}.py").write_text(text)
    assert cycles(graph(root)) == [["pkg.sub.a", "pkg.sub.b", "pkg.sub.c"]]
    (root / "sub" / "c.py").write_text("from pkg.sub import A")  # through the subpackage's `__init__`
    assert cycles(graph(root)) == [["pkg.sub", "pkg.sub.a", "pkg.sub.b", "pkg.sub.c"]]
    (root / "sub" / "c.py").write_text("")
    assert cycles(graph(root)) == []


def test_the_files_of_virtual_are_in_the_order_that_its_docstring_gives():
    files = {path.stem: path for path in (ROOT / "virtual").glob("*.py") if path.stem != "__init__"}
    docstring = ast.get_docstring(ast.parse((ROOT / "virtual" / "__init__.py").read_text(encoding="utf-8")))
    lines = docstring.split("\n- ")[1:]
    place = {name: number for number, line in enumerate(lines) for name in re.findall(r"`(\w+)`", line)}
    assert place.keys() == files.keys()
    for name, path in files.items():
        others = {item.split(".")[2] for item in imported(path) if item.startswith(f"{PACKAGE}.virtual.")}
        assert [other for other in others if place[other] < place[name]] == [], f"{name} imports what stands above it"


# -- what crosses a subpackage's border has a type

ANYTHING = re.compile(r"\b(dict|Dict|Mapping|MutableMapping)\[str, (typing\.)?(Any|object)\]")
#: what is public and holds anything under texts: why
UNTYPED = {
    "controllers/params.py: Params.of": "what stands in YAML below a controller's name; the class checks it",
    "ros/interfaces/definition.py: Structure.constants": "a constant of ROS is a number, a text or a truth value",
}


def untyped(text):
    """Yield what others see of a module and holds anything under texts: functions, methods, fields and aliases."""
    if not re.search(r"\[\s*str,\s*(typing\.)?(Any|object)\b", text):
        return
    for name, annotations in declared(ast.parse(text).body, ""):
        if any(ANYTHING.search(ast.unparse(annotation)) for annotation in annotations if annotation is not None):
            yield name


def declared(body, owner):
    """Yield each public name of a module or class with its annotations."""
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            name = node.name
        elif isinstance(node, ast.AnnAssign | ast.Assign):
            name = ast.unparse(node.target if isinstance(node, ast.AnnAssign) else node.targets[0])
        else:
            continue
        if name.startswith("_") and name != "__init__":
            continue
        if isinstance(node, ast.ClassDef):
            yield from declared(node.body, f"{owner}{name}.")
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            yield f"{owner}{name}", [node.value, getattr(node, "annotation", None)]
        else:
            inputs = [item for item in ast.walk(node.args) if isinstance(item, ast.arg)]
            yield f"{owner}{name}", [node.returns, *(item.annotation for item in inputs)]


def test_what_crosses_a_subpackages_border_has_a_type():
    result = {
        f"{path.relative_to(ROOT).as_posix()}: {name}"
        for path in modules()
        for name in untyped(path.read_text(encoding="utf-8"))
    }
    assert result - UNTYPED.keys() == set(), "make it a structure (rpc.messages.declare.Document), or a dataclass"
    assert UNTYPED.keys() - result == set(), "these are typed by now"
