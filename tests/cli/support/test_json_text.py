import json
import math

import pytest

from canopen_control.cli.support.json_text import json_line, json_text
from canopen_control.rpc.messages.state import JointReading


def test_what_is_printed_is_json_with_the_keys_of_the_messages():
    text = json_text({"joints": [JointReading("é", math.nan)]})
    assert text.isascii()
    assert text.startswith('{\n  "joints"')
    (joint,) = json.loads(text)["joints"]
    assert (joint["name"], joint["position"]) == ("é", None)


def test_without_an_indent_it_is_one_line():
    assert json_text([JointReading("a")], indent=None).startswith('[{"name": "a", ')


@pytest.mark.parametrize("name", ["a", "é"])
def test_a_line_of_a_stream_is_compact(name):
    text = json_line([JointReading(name, math.inf)])
    assert text.startswith('[{"name":"')
    assert text.isascii()
    assert (json.loads(text)[0]["name"], json.loads(text)[0]["position"]) == (name, None)
