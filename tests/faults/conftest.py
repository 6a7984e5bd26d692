"""Benches of the rows of the fault catalogue."""

import contextlib

import pytest
from support.faultbench import FaultBench


@pytest.fixture
def bench(request):
    """Return what makes a bench; all are closed afterwards."""
    with contextlib.ExitStack() as stack:

        def make(**how):
            name = f"fault{abs(hash(request.node.nodeid)) % 10**9}x{len(created)}"
            created.append(FaultBench(name, **how))
            stack.callback(created[-1].close)
            return created[-1]

        created = []
        yield make


@pytest.fixture
def turning(bench):
    """Return a robot that turns its wheels at 10 rad/s."""
    return bench().turning()
