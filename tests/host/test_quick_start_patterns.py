from __future__ import annotations

import re
from types import ModuleType

import pytest

from canopen_control.host.quick_start import _LazyPattern, lazy_patterns

SOURCE = """
import re
WORD = re.compile("(a+)b", re.IGNORECASE)
DATA = re.compile(rb"[0-9]+")
"""


def module_of(name):
    module_type = ModuleType(name)
    with lazy_patterns():
        exec(SOURCE, module_type.__dict__)
    return module_type


@pytest.mark.parametrize("name", ["canopen_control.words", "yaml.words"])
def test_a_pattern_is_compiled_when_it_is_first_used(name):
    with lazy_patterns():
        created = module_of(name)
        assert isinstance(created.WORD, _LazyPattern)
        assert "match" not in vars(created.WORD)
        assert created.WORD.fullmatch("AAb")[1] == "AA"  # also while others are defined
        assert vars(created.WORD)["match"].__self__ == re.compile("(a+)b", re.IGNORECASE)
    assert created.WORD.sub(r"<\1>", "aab ab c") == "<aa> <a> c"
    assert created.DATA.findall(b"1 23") == [b"1", b"23"]


@pytest.mark.parametrize("attribute", ["pattern", "flags", "groups"])
def test_its_attributes_are_those_of_the_standard_one(attribute):
    created = module_of("canopen_control.words")
    assert getattr(created.WORD, attribute) == getattr(re.compile("(a+)b", re.IGNORECASE), attribute)


def test_the_modules_of_others_and_other_times_have_the_standard_ones():
    standard = re.compile
    assert isinstance(module_of("users.words").WORD, re.Pattern)
    assert re.compile is standard
    with pytest.raises(ValueError, match="import"), lazy_patterns():
        raise ValueError("import")
    assert re.compile is standard


def test_a_wrong_pattern_is_refused_when_it_is_used():
    with lazy_patterns():
        wrong = eval("re.compile('(')", {"re": re, "__name__": "canopen_control.words"})
    with pytest.raises(re.error):
        wrong.match("x")
