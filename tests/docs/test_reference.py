"""The generated reference contains every key, parameter, fault and verb, each with a description."""

import dataclasses
import re
import sys
from importlib import import_module
from pkgutil import walk_packages

import pytest
from support.documents import DOCS

from canopen_control import controllers
from canopen_control.cli.verbs import VERBS
from canopen_control.controllers.types import TYPES
from canopen_control.master import keys
from canopen_control.personality import personality_names, read_personality
from canopen_control.rpc.messages.drive import DRIVE
from canopen_control.rpc.messages.hub import HUB
from canopen_control.rpc.messages.robot import ROBOT
from canopen_control.virtual.fault_table import FAULTS
from canopen_control.virtual.quirks import QUIRKS


@pytest.fixture(scope="module")
def generate():
    """The module that makes the pages, and its words."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(DOCS))
        import generate

        yield generate
    for name in ("generate", "protocol", "words"):
        sys.modules.pop(name)


@pytest.mark.rest
def test_every_page_is_made(generate, tmp_path):
    generate.write_pages(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == set(generate.PAGES)
    assert all(path.read_text(encoding="utf-8").startswith("# ") for path in tmp_path.iterdir())


def test_every_key_of_bus_yml_has_its_words_and_no_words_are_left_over(generate):
    classes = (
        keys.FileOptions,
        keys.MasterConfig,
        keys.NodeConfig,
        keys.PdoConfig,
        keys.PdoObjectKeys,
        keys.SdoEntry,
        keys.AxisUnitKeys,
        keys.SignalKeys,
    )
    unused = {keys.MasterConfig: keys.UNUSED_MASTER, keys.NodeConfig: keys.UNUSED_NODE}
    for cls, words in zip(classes, generate.BUS_YML.values(), strict=True):
        assert set(words) == {key for key, _ in generate.entries(cls)} - set(unused.get(cls, ())), cls


def test_every_parameter_is_reported_with_its_words(generate):
    text = generate.controllers()
    modules = [
        import_module(package.name) for package in walk_packages(controllers.__path__, f"{controllers.__name__}.")
    ]
    classes = {
        var
        for module in modules
        for var in vars(module).values()
        if isinstance(var, type) and dataclasses.is_dataclass(var)
    }
    texts = {field.metadata.get("help") for class_name in classes for field in dataclasses.fields(class_name)} - {
        "",
        None,
    }
    assert len(texts) > 150
    assert [word for word in texts if f"| {word} |" not in text] == []
    assert [name for name in TYPES if text.count(f"- `{name}`\n") != 1] == []


def test_every_fault_and_every_verb_is_reported(generate):
    faults, verbs = generate.faults(), generate.command_line()
    assert [name for name in FAULTS if f"| `{name}` |" not in faults] == []
    assert [verb for verb in VERBS if f"\n## {verb}\n" not in verbs] == []


def test_every_quirk_and_every_personality_is_reported(generate):
    quirks, drives = generate.quirks(), generate.personalities()
    assert [name for name in QUIRKS if f"| `{name}` |" not in quirks] == []
    for name in personality_names():
        personality = read_personality(name)
        assert [line.quirk for line in personality.quirks if f"| `{line.quirk}` | {line.source} |" not in drives] == []
        assert [key.text for key in personality.bus_keys if f"| `{key.text}` |" not in drives] == []
        assert f"\n- `{name}`, {personality.title} (vendor id: " in drives


def test_defaults_and_bounds_are_those_of_the_code(generate):
    text = generate.bus_yml()
    assert "| `node_id` | integer, 1 to 127 | required |" in text
    assert "| `heartbeat_multiplier` | number, 1 to 100 | `3.0` |" in text
    assert "| `driver` | the master is this package |" in text


@pytest.mark.parametrize("api", [ROBOT, DRIVE, HUB], ids=lambda each: each.name)
def test_every_method_of_a_socket_and_every_structure_is_reported(generate, api):
    text = generate.PAGES[f"{api.name}_socket.md"]()
    assert [name for name in api.methods if f"| `{name}` |" not in text] == []
    targets = set(re.findall(r"\]\(#(\w+)\)", text))
    assert targets == {title.lower() for title in re.findall(r"^### (\w+)$", text, re.MULTILINE)}
    assert not re.search(r"typing|Annotated|Optional|<class", text)


def test_the_guide_lists_the_writable_parameters_of_every_controller():
    section = (DOCS / "guide" / "ros2.md").read_text(encoding="utf-8").split("| writable parameters |")[1]
    listed = [set(re.findall(r"`([\w.]+)`", row)) for row in re.findall(r"^\| \w.*\|$", section, re.MULTILINE)]
    classes = {getattr(import_module(path.split(":")[0]), path.split(":")[1]) for path in TYPES.values()}
    settable = [{re.sub(r"^(gains|constraints)\..*|\.\*$", r"\1", name) for name in cls.settable} for cls in classes]
    assert sorted(map(sorted, listed)) == sorted(
        {tuple(sorted(names)): sorted(names) for names in settable if names}.values()
    )
