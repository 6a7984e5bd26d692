"""Modules and names that docs, docstrings and comments refer to exist."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "canopen_control"
MODULES = [path for path in sorted(PACKAGE.rglob("*.py")) if path.parent != PACKAGE / "data"]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("[!_]*/*.md"))]
SUBPACKAGES = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
FILE = re.compile(r"(?<![\w./*-])(?:[a-z_0-9]+/)*[a-z_0-9]+\.py\b(?!:)")
DOTTED = re.compile(rf"`(?:canopen_control\.)?((?:{'|'.join(sorted(SUBPACKAGES))})\.[a-z_]\w+(?:\.\w+)*)`")
WORD = re.compile(r"(?<![`\w])`([a-z0-9]+(?:_[a-z0-9]+)+)`(?!`)")
SNAKE = re.compile(r"[A-Za-z0-9]+(?:_[A-Za-z0-9]+)+")
FOLDERS = ("canopen_control", "docs", "tests", "tools")
ENDINGS = {"yml", "yaml", "urdf", "html", "json"}  # `bus.yml` is a file of a robot
#: files of others: the reader's own verb, programs of ROS
FOREIGN_FILES = {"tests/cli/test_where.py", "spawner.py", "spawn_entity.py"}
FOREIGN_NAMES = {"trigger_joint_command_threshold"}  # of joint_state_topic_hardware_interface


def read_all(paths):
    """Return (path below the checkout, text) of each."""
    return [(path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8")) for path in paths]


def missing_files(text, files):
    """Return the names of Python files in a text that end no path of `files`."""
    names = set(FILE.findall(text)) - FOREIGN_FILES
    return sorted(name for name in names if not any(path == name or path.endswith(f"/{name}") for path in files))


def missing_modules(text, package):
    """Return the dotted names in a text whose second part is neither a module nor a name of its subpackage."""
    results = []
    for name in DOTTED.findall(text):
        folder, second = name.split(".")[:2]
        if second in ENDINGS or (package / folder / second).is_dir() or (package / folder / f"{second}.py").exists():
            continue
        if not re.search(rf"\b{second}\b", (package / folder / "__init__.py").read_text(encoding="utf-8")):
            results.append(name)
    return results


def test_every_python_file_that_is_named_exists():
    files = [path.relative_to(ROOT).as_posix() for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")]
    result = {path: names for path, text in read_all(PAGES + MODULES) if (names := missing_files(text, files))}
    assert result == {}


def test_every_module_that_is_named_with_its_subpackage_exists():
    result = {path: names for path, text in read_all(PAGES + MODULES) if (names := missing_modules(text, PACKAGE))}
    assert result == {}


def test_every_name_in_backticks_of_a_docstring_is_one_of_the_code():
    texts = read_all(MODULES)
    named = {path: set(WORD.findall(text)) for path, text in texts}
    known = FOREIGN_NAMES | {path.stem for path in MODULES}
    for _, text in texts:
        known.update(SNAKE.findall(re.sub(r"`[^`\n]*`", "", text)))
    result = {path: names - known for path, names in named.items() if names - known}
    assert result == {}, "name what exists: a module, a function, a field"


def test_stale_names_are_found():
    assert missing_files("see master/gone.py and boot.py, or NAME.py", ["canopen_control/master/boot.py"]) == [
        "master/gone.py"
    ]
    assert missing_modules("`master.gone.Plan` `canopen_control.master.boot.Boot` `bus.yml`", PACKAGE) == [
        "master.gone.Plan"
    ]
    assert WORD.findall("`plan_builder` ``x_y`` `plain`") == ["plan_builder"]
