from __future__ import annotations

import contextlib
import dataclasses
import gc
import inspect
import pickle
import re
import sys
from types import ModuleType

import pytest

from canopen_control.host.quick_start import _Method, quick_dataclasses, quick_imports, quick_start


@pytest.mark.parametrize("fails", [False, True])
def test_the_collector_is_off_for_a_start_only(fails):
    frozen = gc.get_freeze_count()
    assert gc.isenabled()
    try:
        with contextlib.suppress(ValueError), quick_start():
            assert not gc.isenabled()
            if fails:
                raise ValueError
        assert gc.isenabled()
        assert (gc.get_freeze_count() > frozen) is not fails
    finally:
        gc.unfreeze()


@pytest.mark.parametrize("context", [quick_imports, quick_start])
def test_imports_are_as_before_afterwards(context):
    before = dataclasses.dataclass, getattr(dataclasses, "_create_fn", None), re.compile
    try:
        with context():
            assert re.compile is not before[2]
        assert (dataclasses.dataclass, getattr(dataclasses, "_create_fn", None), re.compile) == before
    finally:
        gc.unfreeze()


# Dataclasses whose methods are made on first use are dataclasses in every other respect.


SOURCE = """
from __future__ import annotations
from dataclasses import KW_ONLY, InitVar, dataclass, field
from typing import ClassVar

@dataclass(frozen=True, slots=True)
class Point:
    'A point.'
    x: int
    y: float = 0.5
    names: list = field(default_factory=list, compare=False)

@dataclass(order=True)
class Base:
    'A base.'
    number: int
    def __post_init__(self):
        self.doubled = 2 * self.number

@dataclass
class Derived(Base):
    'Derived.'
    other: str = "a"

@dataclass
class Special:
    'Fields that are none, and one by its name only.'
    shared: ClassVar[int] = 3
    seed: InitVar[int]
    _: KW_ONLY
    number: int = 0
    def __post_init__(self, seed):
        self.number += seed
"""


@pytest.fixture(params=[True, False], ids=["quick", "standard"])
def module(request, monkeypatch):
    module_type = ModuleType("canopen_control.quick_module")
    module_type.__file__ = "quick_module.py"
    monkeypatch.setitem(sys.modules, module_type.__name__, module_type)
    if request.param:
        with quick_dataclasses():
            exec(SOURCE, module_type.__dict__)
    else:
        exec(SOURCE, module_type.__dict__)
    return module_type


def test_they_behave_as_the_standard_ones(module):
    one, same, other = module.Point(1), module.Point(1, 0.5, ["z"]), module.Point(2, y=3.0)
    assert one == same != other
    assert hash(one) == hash(same)
    assert repr(other) == "Point(x=2, y=3.0, names=[])"
    with pytest.raises(dataclasses.FrozenInstanceError, match="cannot assign to field 'x'"):
        one.x = 3
    with pytest.raises(dataclasses.FrozenInstanceError, match="cannot delete field 'x'"):
        del one.x
    with pytest.raises(TypeError, match=r"Point\.__init__\(\) missing 1 required positional argument: 'x'"):
        module.Point()
    assert dataclasses.replace(one, x=4) == module.Point(4)
    assert dataclasses.asdict(other) == {"x": 2, "y": 3.0, "names": []}
    assert pickle.loads(pickle.dumps(other)) == other
    assert str(inspect.signature(module.Point)) == "(x: 'int', y: 'float' = 0.5, names: 'list' = <factory>) -> None"
    assert module.Point.__eq__.__qualname__ == "Point.__eq__"
    match other:
        case module.Point(x, y):
            assert (x, y) == (2, 3.0)


def test_they_are_ordered_and_inherit(module):
    derived = module.Derived(3)
    assert (derived.doubled, derived.other) == (6, "a")
    assert module.Base(1) < module.Base(2) <= module.Base(2)
    assert not module.Base(1) > module.Base(2)
    assert derived != module.Base(3)
    assert module.Derived(3) == derived
    assert repr(derived) == "Derived(number=3, other='a')"
    assert module.Base.__hash__ is None


def test_what_is_not_a_field_is_recognised_by_its_annotation(module):
    assert [field.name for field in dataclasses.fields(module.Special)] == ["number"]
    assert module.Special(4, number=2).number == 6
    assert (module.Special.shared, module.Special(1).number) == (3, 1)
    with pytest.raises(TypeError, match="positional argument"):
        module.Special(4, 2)


@pytest.mark.skipif(sys.version_info >= (3, 13), reason="Python makes the methods of a class at once")
def test_a_method_is_made_when_it_is_first_used():
    module_type = ModuleType("canopen_control.quick_module")
    module_type.__file__ = "quick_module.py"
    sys.modules[module_type.__name__] = module_type
    with quick_dataclasses():
        exec(SOURCE, module_type.__dict__)
    del sys.modules[module_type.__name__]
    methods = vars(module_type.Point)
    assert isinstance(methods["__eq__"], _Method)
    assert isinstance(methods["__init__"], _Method)
    module_type.Point(1)
    assert isinstance(methods["__eq__"], _Method)
    assert inspect.isfunction(vars(module_type.Point)["__init__"])
    assert dataclasses._create_fn.__module__ == "dataclasses"


@pytest.mark.parametrize(
    ("name", "file"),
    [("canopen_control.quick_module", "quick_module.cpython-311-x86_64-linux-gnu.so"), ("users", "users.py")],
)
def test_compiled_modules_and_those_of_others_have_the_standard_ones(monkeypatch, name, file):
    module_type = ModuleType(name)
    module_type.__file__ = file
    monkeypatch.setitem(sys.modules, module_type.__name__, module_type)
    with quick_dataclasses():
        exec(SOURCE, module_type.__dict__)
    assert inspect.isfunction(vars(module_type.Point)["__eq__"])
