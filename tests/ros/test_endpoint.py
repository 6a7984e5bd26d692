from __future__ import annotations

from canopen_control.ros.endpoint import Endpoint


def test_an_endpoint_takes_everything_and_cares_for_nothing():
    endpoint = Endpoint()
    assert endpoint.on_state({}) is endpoint.on_event({}) is endpoint.on_controller(None) is None
    assert endpoint.on_process_data({}) is endpoint.close() is None
