"""A bus.yml in a folder of its own, and what is wrong with one."""

import shutil
import textwrap

import pytest

from canopen_control.data_files import data_path
from canopen_control.errors import BusConfigError
from canopen_control.master.config import inspect_bus, read_bus


def write(folder, text):
    shutil.copy(data_path("eds", "TMCM-1270.eds"), folder)
    path = folder / "bus.yml"
    path.write_text(textwrap.dedent(text))
    return path


def mistakes(folder, text):
    with pytest.raises(BusConfigError) as caught:
        read_bus(write(folder, text))
    return str(caught.value)


def mistakes_of_a_node(folder, keys):
    """What is wrong with further keys of a node, which stand at line 13."""
    node = "right_drive: {node_id: 2"
    text = mistakes(folder, NESTED.replace(node, f"{node}, {keys}"))
    assert "bus.yml:13:" in text
    return text


NESTED = """\
    master:
      node_id: 1
      sync_period: 20000
    defaults:
      dcf: TMCM-1270.eds
      heartbeat_producer: 100
      tpdo:
        1: {enabled: true, transmission: 1}
    nodes:
      left_drive:
        node_id: 3
        heartbeat_producer: 50
      right_drive: {node_id: 2}
    """

MERGED = """\
    master: {node_id: 1}
    defaults:
      dcf: TMCM-1270.eds
      heartbeat_producer: 100
      rpdo: {1: {mapping: [{index: 0x6040}]}}
    nodes:
      left:
        node_id: 3
        heartbeat_producer: 50
        rpdo: {2: {mapping: [{index: 0x60FF}]}}
    """


def warnings_of(path):
    """Return the warnings of a bus.yml as text."""
    _, problems = inspect_bus(path)
    return [str(problem) for problem in problems.warnings]


def with_node(tmp_path, keys):
    """Return the bus of NESTED with more keys of its node `right_drive`."""
    return read_bus(write(tmp_path, NESTED.replace("right_drive: {node_id: 2", f"right_drive: {{node_id: 2, {keys}")))
