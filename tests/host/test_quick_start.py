from __future__ import annotations

import contextlib
import dataclasses
import gc
import re

import pytest

from canopen_control.host.quick_start import quick_imports, quick_start


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
