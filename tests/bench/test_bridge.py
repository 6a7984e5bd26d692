"""What the bridge costs: the measuring itself, and once in small with everybody there."""

import pytest
from canopen_control_bench import bridge
from canopen_control_bench.runner import Options
from canopen_control_bench.stage import stage

from canopen_control.errors import CanopenError, ConfigError


def test_without_ros_it_is_left_out_in_a_sentence(monkeypatch):
    def no_ros():
        raise ConfigError("ROS 2 is not installed")

    said = []
    monkeypatch.setattr(bridge, "require_ros", no_ros)
    assert bridge.measure(Options(say=said.append)) == []
    assert said == ["bridge: left out; ROS 2 is not installed"]


@pytest.mark.ros
def test_bridge_and_peer_are_measured_and_commands_are_timed():
    with stage() as played:
        bench = bridge.BridgeBench(played)
        for cost in (bench.bridge_us(0.3), bench.plain_us(0.3)):
            assert 10 < cost < 100_000
        latencies = bench.latencies_s(8)
        assert 4 <= len(latencies) <= 8
        assert all(0 < each < 5 for each in latencies)
        bench._bridge.process.kill()
        with pytest.raises(CanopenError, match="only 0 of 4 commands"):
            bench.latencies_s(4)
