"""`canopen_control/a/b.py` is tested by `tests/a/test_b.py`."""

from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "canopen_control"


def test_every_module_has_its_test_module():
    missing = []
    for path in sorted(PACKAGE.rglob("*.py")):
        relative = path.relative_to(PACKAGE)
        if relative.name.startswith("__") or relative.parts[0] == "data":
            continue
        if not (ROOT / "tests" / relative.parent / f"test_{relative.name}").exists():
            missing.append(str(relative))
    assert missing == []


def test_every_test_module_has_its_module_or_is_about_the_whole():
    whole = {"test_layering.py", "test_mirror.py"}
    rooms = ("_properties.py", "_vectors.py", "_interop.py")  # about a room as a whole
    strays = []
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        relative = path.relative_to(ROOT / "tests")
        module = PACKAGE / relative.parent / relative.name.removeprefix("test_")
        if (
            relative.parts[0] not in ("integration", "tools", "faults", "socketcan", "hardware_can")
            and relative.name not in whole
            and not module.exists()
            and not relative.name.endswith(rooms)
        ):
            strays.append(str(relative))
    assert strays == []
