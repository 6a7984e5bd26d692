"""EDS texts for the tests, and a count of the work that reading them costs."""

import sys
from pathlib import Path

from canopen_control import od
from canopen_control.od.eds import parse_eds

__all__ = ["MALFORMED", "codes", "eds", "lines_executed", "parse", "section"]

TESTS = Path(__file__).parents[1]
MALFORMED = TESTS / "od" / "malformed"
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
