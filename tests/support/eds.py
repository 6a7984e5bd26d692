"""EDS texts for the tests, and a count of the work that reading them costs."""

import sys
from pathlib import Path

from hypothesis import strategies as st

from canopen_control import od
from canopen_control.od.eds import parse_eds

TESTS = Path(__file__).parents[1]
MALFORMED = TESTS / "od" / "malformed"
DEVIATIONS = TESTS / "od" / "deviations"
_ROOM = str(Path(od.__file__).parent)

DEVICE_TYPE = "[1000]\nParameterName=Device type\nDataType=7\nAccessType=ro\nDefaultValue=0\n"


def section(title, **keys):
    """Make the text of a section; a value of None leaves the key out."""
    lines = [f"{key}={value}" for key, value in keys.items() if value is not None]
    return "\n".join([f"[{title}]", *lines, ""])


def eds(title="2000", name="Thing", data_type=7, access="rw", **keys):
    """Make the text of a scalar object."""
    return section(title, ParameterName=name, ObjectType="0x7", DataType=data_type, AccessType=access, **keys)


def parse(*texts, node_id=None):
    """Parse sections that are text."""
    return parse_eds("\n".join(texts).encode(), node_id)


def codes(file, *ignored):
    """Return the codes of the issues, without those that every fragment has."""
    fragment = {"device-info", "list-missing", "object-mandatory", *ignored}
    return [issue.code for issue in file.issues if issue.code not in fragment]


def lines_executed(function):
    """Count the lines of `canopen_control.od` that run in `function`."""
    count = 0

    def trace_lines(_frame, event, _arg):
        nonlocal count
        count += event == "line"
        return trace_lines

    def trace_calls(frame, _event, _arg):
        return trace_lines if frame.f_code.co_filename.startswith(_ROOM) else None

    before = sys.gettrace()
    sys.settrace(trace_calls)
    try:
        function()
    finally:
        sys.settrace(before)
    return count


SEEDS = [path.read_bytes() for path in sorted([*MALFORMED.glob("*.eds"), *DEVIATIONS.glob("*.eds")])]
NASTY = [
    *(b"", b"\n", b"\r", b"\x1a", b"\0", b"=", b"[", b"]", b"[1000]\n", b"[1018sub1]", b"[1003Value]\n1=5\n"),
    *(b"$NODEID", b"+$NODEID", b"0x", b"-1", b"1e999", b"0xFFFFFFFFFFFFFFFFFF", b"9" * 5000, b"\xff\xfe", b"\xe9"),
    *(b"CompactSubObj=99999\n", b"CompactSubObj=254\n", b"ObjectType=0x9\n", b"DataType=0x8\n", b"SubNumber=x\n"),
    *(b"DefaultValue=0x7FC00000\n", b"LowLimit=5\nHighLimit=1\n", b"CompactPDO=0x3F\n", b"NrOfRXPDO=3\n", b"%s%(x)s"),
]


@st.composite
def mutated(draw):
    """Draw one of the files after a few cuts, copies and insertions."""
    data = draw(st.sampled_from(SEEDS))
    for _ in range(draw(st.integers(1, 6))):
        start = draw(st.integers(0, len(data)))
        end = min(len(data), start + draw(st.sampled_from((0, 0, 1, 7, 60, 600))))
        piece = draw(st.sampled_from(NASTY) | st.binary(max_size=8) | st.just(data[start:end] * 2))
        data = data[:start] + piece + data[end:]
    return data
