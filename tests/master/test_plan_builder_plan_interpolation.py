"""0x60C2 of a plan: the SYNC period exactly, or told."""

import re
import shutil

import pytest

from canopen_control.data_files import data_path
from canopen_control.master.config import inspect_bus

ASKED = """    - {index: 0x60C2, sub_index: 1, value: 20}       # interpolation period: the SYNC period ...
    - {index: 0x60C2, sub_index: 2, value: -3}       # ... in 10^-3 s
"""


def read(folder, period, asked):
    """Return what the plan of arm6's first drive writes to 0x60C2 as (value, exponent), and the warnings."""
    target = folder / "arm6"
    shutil.copytree(data_path("config", "arm6"), target)
    path = target / "bus.yml"
    text = path.read_text()
    assert ASKED in text
    path.write_text(text.replace(ASKED, asked).replace("sync_period: 20000", f"sync_period: {period}"))
    config, problems = inspect_bus(path)
    assert not problems.errors, problems.errors
    writes = [write for write in config.plans["joint_1_drive"].writes if write.index == 0x60C2]
    values = tuple(int.from_bytes(write.data, "little", signed=write.subindex == 2) for write in writes)
    return values, [str(each) for each in problems.warnings if "60C2" in str(each)]


def test_another_time_in_a_dcf_is_told_at_the_file(tmp_path):
    eds = data_path("eds", "generic_cia402.eds").read_text()
    dcf = re.sub(r"(?m)^(\[60C2sub1\](?:\n[^\[\n]+)*)", r"\1\nParameterValue=10", eds)
    (tmp_path / "drive.dcf").write_text(dcf)
    path = tmp_path / "bus.yml"
    path.write_text(
        "master: {node_id: 1, sync_period: 20000}\nnodes:\n  lift:\n    node_id: 2\n    dcf: drive.dcf\n    sdo:\n"
        "      - {index: 0x6081, sub_index: 0, value: 5}\n"
    )
    (told,) = [str(each) for each in inspect_bus(path)[1].warnings if "60C2" in str(each)]
    assert "bus.yml:5:" in told
    assert "0x60C2 is 10 * 10^-3 s" in told


@pytest.mark.parametrize(
    ("period", "written"),
    [
        (20000, (20, -3)),
        (12500, (125, -4)),
        (1000, (1, -3)),
        (500, (5, -4)),
        (250, (25, -5)),
        (8000, (8, -3)),
        (100_000, (100, -3)),
        (1_000_000, (1, 0)),
    ],
)
def test_the_period_is_written_exactly(tmp_path, period, written):
    values, warnings = read(tmp_path, period, "")
    assert values[0] * 10.0 ** values[1] == pytest.approx(period / 1e6, rel=1e-12)
    if period < 1_000_000:
        assert values == written
    assert warnings == []


def test_a_period_that_the_object_cannot_hold_is_told_with_what_to_do(tmp_path):
    values, warnings = read(tmp_path, 3333, "")
    assert values[0] * 10.0 ** values[1] == pytest.approx(0.0033, abs=1e-4)
    (warning,) = warnings
    assert "3333 us is none" in warning
    assert "take another sync_period" in warning


@pytest.mark.parametrize(("value", "exponent"), [(2, -2), (200, -4), (20, -3)])
def test_the_same_time_in_another_unit_is_no_mistake(tmp_path, value, exponent):
    lines = [f"    - {{index: 0x60C2, sub_index: {sub}, value: {each}}}\n" for sub, each in ((1, value), (2, exponent))]
    asked = "".join(lines)
    values, warnings = read(tmp_path, 20000, asked)
    assert (values, warnings) == ((value, exponent), [])


@pytest.mark.parametrize(
    "asked",
    [
        "    - {index: 0x60C2, sub_index: 1, value: 50}\n    - {index: 0x60C2, sub_index: 2, value: -3}\n",
        "    - {index: 0x60C2, sub_index: 1, value: 0}\n    - {index: 0x60C2, sub_index: 2, value: -3}\n",
        "    - {index: 0x60C2, sub_index: 1, value: 200}\n",  # in the unit that the EDS has
    ],
)
def test_another_time_than_syncs_is_told_where_it_stands(tmp_path, asked):
    _, warnings = read(tmp_path, 20000, asked)
    assert len(warnings) == 1
    assert "leave 0x60C2 out, the boot writes it" in warnings[0]
    assert "bus.yml:20:7: defaults.sdo[1]" in warnings[0]
