"""File names are unique in the package, except in subpackages that name their files by a rule."""

import ast
from pathlib import Path

from canopen_control.cli.verbs import VERBS

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "canopen_control"
#: files of these subpackages have the name of what they are for, and may share it with whoever does the work
NAMED_BY_A_RULE = {
    "cli": "a verb's file is the verb's name",
    "rpc/messages": "NAME.py is what goes over the socket of NAME, or a part of that",
}
#: file -> why it may stand in several subpackages
SHARED = {"params.py": "of all controllers, and those of a trajectory in its folder"}


def shared_names(package):
    """Return the file names that several subpackages without a rule have, and where."""
    places = {}
    for path in package.rglob("*.py"):
        subpackage = path.relative_to(package).parent.as_posix()
        if not path.name.startswith("__") and subpackage not in NAMED_BY_A_RULE:
            places.setdefault(path.name, []).append(subpackage)
    return {name: sorted(subpackages) for name, subpackages in places.items() if len(subpackages) > 1}


def test_no_name_is_in_two_subpackages_without_a_reason():
    result = shared_names(PACKAGE)
    assert {name: subpackages for name, subpackages in result.items() if name not in SHARED} == {}, (
        "say which side each of them is"
    )
    assert SHARED.keys() - result.keys() == set(), "these stand in one subpackage by now"


def test_a_verbs_file_is_the_verbs_name():
    files = {path.stem for path in (PACKAGE / "cli").glob("*.py")} - {"__init__", "main", "verbs"}
    assert files == set(VERBS)


def public_classes(package):
    """Return the public classes of the modules below `package`, and the modules that each is defined in."""
    places = {}
    for path in sorted(package.rglob("*.py")):
        if "share" not in path.parts:
            for node in ast.parse(path.read_text(encoding="utf-8")).body:
                if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                    places.setdefault(node.name, []).append(path.relative_to(package).as_posix())
    return places


def test_no_two_public_classes_share_a_name():
    assert {name: files for name, files in public_classes(PACKAGE).items() if len(files) > 1} == {}


def test_a_second_class_of_a_name_would_be_seen(tmp_path):
    for name in ("a.py", "b.py"):
        (tmp_path / name).write_text("class Axis:\n    pass\n\n\nclass _Private:\n    pass\n")
    assert public_classes(tmp_path) == {"Axis": ["a.py", "b.py"]}
