import ast
from pathlib import Path

import canopen_control
from canopen_control.od import indices

NAMES = {
    name: value
    for name, value in vars(indices).items()
    if name.isupper() and isinstance(value, int) and name != "FIRST_OBJECT"  # the limit of a range, not an object
}
VALUES = frozenset(NAMES.values())


def module_constants(path):
    """Yield the name of each module constant that is the index of one of these objects, written in hexadecimal."""
    text = path.read_text(encoding="utf-8")
    for node in ast.parse(text).body:
        pairs = []
        if isinstance(node, ast.Assign):
            target = node.targets[0]
            both = isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple)
            pairs = zip(target.elts, node.value.elts, strict=True) if both else [(target, node.value)]
        elif isinstance(node, ast.AnnAssign) and node.value is not None:
            pairs = [(node.target, node.value)]
        for name, value in pairs:
            if not isinstance(value, ast.Constant) or value.value not in VALUES:
                continue
            if text.splitlines()[value.lineno - 1][value.col_offset :].startswith("0x"):
                yield ast.unparse(name)


def test_every_name_is_one_object_of_the_communication_profile():
    assert len(set(NAMES.values())) == len(NAMES) > 20
    assert all(0x1000 <= value < 0x2000 for value in NAMES.values())


def test_no_other_module_names_one_of_these_objects_again():
    root = Path(canopen_control.__file__).parent
    again = {
        f"{path.relative_to(root)}: {name}"
        for path in root.rglob("*.py")
        if path.name != "indices.py"
        for name in module_constants(path)
        if name != "_FIRST_OBJECT"  # the first index above the data types
    }
    assert again == set()
