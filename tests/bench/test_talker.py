"""The talker: so many frames, one by one, of the drives that it is told."""

from collections import Counter

import pytest
from canopen_control_bench.listener import listening
from canopen_control_bench.stage import stage
from canopen_control_bench.talker import talk

pytestmark = pytest.mark.process


def test_it_sends_what_it_says():
    with stage(), listening("local:talk") as hear:
        assert talk("local:talk", range(2, 4), 2000.0, 0.1) == 200
        frames = hear(0.3)
    assert Counter(frame.can_id for frame in frames) == {0x282: 100, 0x283: 100}
    assert {len(frame.data) for frame in frames} == {8}
