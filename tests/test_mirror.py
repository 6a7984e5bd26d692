"""`canopen_control/a/b.py` is tested by `tests/a/test_b.py` or by parts of it, `tests/a/test_b_PART.py`.

Of the bench in tools/, `tests/bench` tests what judges and compares; its families run in every `.ci/run`.
"""

from pathlib import Path

ROOT = Path(__file__).parents[1]
TESTS = ROOT / "tests"
PACKAGE = ROOT / "canopen_control"
BENCH = ROOT / "tools" / "canopen_control_bench"
WHOLE = (
    "test_code_mutants.py",
    "test_compiled_modules.py",
    "test_file_names.py",
    "test_layering.py",
    "test_lockstep.py",
    "test_mirror.py",
    "test_public_surface.py",
)
SUBPACKAGES = ("docs", "integration", "tools", "faults", "socketcan", "hardware_can")  # about whole programs
ENDINGS = ("_properties.py", "_vectors.py", "_interop.py")  # about a subpackage as a whole


def mirrored(package, folder):
    """Yield (module, its test module) of a package whose tests are in `folder`."""
    for path in sorted(package.rglob("*.py")):
        relative = path.relative_to(package)
        if not relative.name.startswith("__") and relative.parts[0] != "data":
            yield path, folder / relative.parent / f"test_{relative.name}"


PAIRS = list(mirrored(PACKAGE, TESTS))
BENCH_PAIRS = list(mirrored(BENCH, TESTS / "bench"))


def modules_that_test(test):
    """Return the test modules of a module: the one of its name, and its parts."""
    return [*test.parent.glob(test.name), *test.parent.glob(f"{test.stem}_*.py")]


def test_every_module_has_its_test_module():
    assert [str(module.relative_to(ROOT)) for module, test in PAIRS if not modules_that_test(test)] == []


def test_every_test_module_has_its_module_or_is_about_the_whole():
    tested = {item for _, test in [*PAIRS, *BENCH_PAIRS] for item in modules_that_test(test)}
    strays = [
        str(path.relative_to(TESTS))
        for path in sorted(TESTS.rglob("test_*.py"))
        if path not in tested
        and path.relative_to(TESTS).parts[0] not in SUBPACKAGES
        and path.name not in WHOLE
        and not path.name.endswith(ENDINGS)
    ]
    assert strays == []
