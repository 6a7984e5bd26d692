from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.properties import examples

from canopen_control.controllers.controllers_file import inspect_controllers, is_within, read_controllers
from canopen_control.controllers.params import CommonParams
from canopen_control.errors import RobotConfigError

CONFIG = Path(__file__).parents[2] / "config"
JAZZY = """\
controller_manager:
  ros__parameters:
    update_rate: 50
    states:
      type: joint_state_broadcaster/JointStateBroadcaster
    base.type: diff_drive_controller/DiffDriveController
base:
  ros__parameters:
    wheel_radius: 0.1
    linear.x.max_velocity: 1.0
    linear: {x: {max_acceleration: 2.0}}
"""


@pytest.fixture
def file(tmp_path):
    def write(text: str, **options):
        path = tmp_path / "c.yaml"
        path.write_text(text, encoding="utf-8")
        return read_controllers(path, **options)

    return write


@dataclass(frozen=True)
class Some:
    rate: float = 1.0


def flat(config) -> dict[str, object]:
    return config.params.flat.value


@pytest.mark.parametrize(
    ("options", "mistake"),
    [("[-r, '~/commands:=/speeds']", None), ("[-p, 'x:=1']", "'-p' is not a remapping"), ("-r", "'' after")],
)
def test_the_arguments_of_a_controllers_node_are_remappings(tmp_path, options, mistake):
    path = tmp_path / "ros2_controllers.yaml"
    block = f"{{type: x/Y, node_options_args: {options}}}"
    path.write_text(f"controller_manager:\n  ros__parameters:\n    base: {block}\n")
    if mistake is None:
        assert read_controllers(path).controllers["base"].node_options == ("-r", "~/commands:=/speeds")
        return
    with pytest.raises(RobotConfigError, match=rf"ros2_controllers\.yaml:3:.*node_options_args: .*{mistake}"):
        read_controllers(path)


def test_robbys_file_names_the_forward_controller_first_of_those_that_move():
    read = read_controllers(CONFIG / "robby" / "ros2_controllers.yaml", strict=True)
    assert read.update_rate == 50
    assert read.warnings == []
    moving = [name for name, each in read.controllers.items() if "broadcaster" not in each.type]
    assert moving[0] == "robby_forward_controller"
    assert flat(read.controllers["robby_forward_controller"])["command_timeout"] == 2.0


def test_types_and_parameters_are_in_their_blocks(file):
    read = file(JAZZY)
    assert list(read.controllers) == ["states", "base"]
    base = read.controllers["base"]
    assert (base.type, base.line) == ("diff_drive_controller/DiffDriveController", 6)
    assert flat(base) == {"wheel_radius": 0.1, "linear.x.max_velocity": 1.0, "linear.x.max_acceleration": 2.0}


@pytest.mark.parametrize(
    "text",
    [
        "base: {ros__parameters: {type: a/B, k: 1}}",
        "/base: {ros__parameters: {type: a/B, k: 1}}",
        "/ns/base: {ros__parameters: {type: a/B, k: 1}}",
        "ns: {base: {ros__parameters: {type: a/B, k: 1}}}",
        "base: {type: a/B, k: 1}",
        "robot: {base: {type: a/B, k: 1}}",
        "ns:\n controller_manager: {ros__parameters: {base: {type: a/B}}}\n base: {ros__parameters: {k: 1}}",
        "controller_manager: {ros__parameters: {base: {type: a/B}}}\n/**: {ros__parameters: {k: 1}}",
        "controller_manager: {base: {type: a/B}}\nbase: {k: 1}",
    ],
)
def test_every_layout_gives_the_same_controller(file, text):
    base = file(text).controllers["base"]
    assert base.type == "a/B"
    assert flat(base)["k"] == 1


def test_a_repeated_name_is_a_warning_and_the_last_one_wins_or_an_error_if_strict(file):
    text = "c: {ros__parameters: {type: a/B,\n rate: 1,\n rate: 2, a.b: 1,\n a: {b: 2}}}"
    read = file(text)
    assert flat(read.controllers["c"]) == {"type": "a/B", "rate": 2, "a.b": 2}
    assert [warning.split(": ", 1)[0].rpartition("/")[2] for warning in read.warnings] == ["c.yaml:3:2", "c.yaml:4:6"]
    with pytest.raises(RobotConfigError, match="duplicate key 'rate'"):
        file(text, strict=True)


def test_parameters_that_is_not_loaded_and_stray_lines_are_reported_with_the_nearest_name(file):
    read = file(JAZZY + "other: {ros__parameters: {k: 1}}\nstray: 3\n")
    assert "'other' has parameters but no type, so it is not loaded; known: states, base" in read.warnings[0]
    assert "'stray' does not belong to a controller" in read.warnings[1]


def test_the_managers_own_errors_are_reported_and_its_other_groups_are_left_alone(file):
    text = "controller_manager: {ros__parameters: {update_rate: 0, defaults: {x: 1}, c: {type: a/B}}}"
    with pytest.raises(RobotConfigError, match=r"update_rate: 0 is out of range 1\.\.10000"):
        file(text)
    read = file(text.replace("update_rate: 0", "updat_rate: 7"))
    assert "unknown key 'updat_rate' (did you mean 'update_rate'?)" in read.warnings[0]
    assert len(read.warnings) == 1


def test_a_file_without_controllers_or_without_yaml_is_refused(file):
    for text in ("", "controller_manager: {ros__parameters: {update_rate: 5}}"):
        with pytest.raises(RobotConfigError, match="no controller has a type"):
            file(text)
    for text in ("[1]", "3", "a: [", "\t"):
        with pytest.raises(RobotConfigError, match=r"c\.yaml:\d"):
            file(text)


def test_the_errors_of_one_controller_do_not_show_at_another(file):
    read = file("a: {ros__parameters: {type: a/B, rate: x}}\nb: {ros__parameters: {type: a/B, rate: 3}}")
    for _ in range(2):
        with pytest.raises(RobotConfigError, match=r"c\.yaml:1:40: a\.ros__parameters\.rate: expected a number"):
            read.controllers["a"].params.read(Some)
        assert read.controllers["b"].params.read(Some).rate == 3.0


def test_what_the_manager_does_not_do_is_reported_with_its_line(file):
    own = "update_rate: 50, use_sim_time: true, lock_memory: {}, handle_exceptions: true"
    text = "controller_manager: {{ros__parameters: {{c.type: a/B, {}}}}}"
    assert file(text.format(own.format("false"))).warnings == []
    (warning,) = file(text.format(own.format("true"))).warnings
    assert "c.yaml:1:" in warning
    assert "lock_memory has no effect: run --realtime locks the memory" in warning


LINES = st.lists(
    st.sampled_from(
        [
            "controller_manager:",
            "  ros__parameters:",
            "    update_rate: 5",
            "    c:",
            "      type: a/B",
            "    c.type: 3",
            "c: {type: a/B}",
            "/**:",
            "d:",
            "  type: [1]",
            "  ? x",
            "- 1",
            "e: {f: {type: a/B}, g: {h: 1}}",
            "controller_manager: {c: {type: {a: 1}}}",
        ]
    ),
    max_size=10,
)


@pytest.mark.rest
@given(st.one_of(LINES.map("\n".join), st.text(max_size=40)))
@settings(max_examples=examples(300))
def test_any_text_gives_controllers_or_one_error(tmp_path_factory, text):
    path = tmp_path_factory.getbasetemp() / "any.yaml"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    try:
        assert read_controllers(path).controllers
    except RobotConfigError as error:
        assert str(error).startswith(str(path))  # noqa: PT017 - either outcome is right


def test_a_params_file_is_read_next_to_the_file_and_wins(file, tmp_path):
    (tmp_path / "first.yaml").write_text("/**: {ros__parameters: {k: 1, only: 7}}\n")
    (tmp_path / "second.yaml").write_text("base: {ros__parameters: {k: 2, linear.x.max_velocity: 3.0}}\n")
    manager = "controller_manager: {ros__parameters: {base: {type: a/B, params_file: %s}}}\n"
    text = manager + "base: {ros__parameters: {k: 0}}\n"
    assert flat(file(text % "[first.yaml, second.yaml]").controllers["base"]) == {
        "k": 2,
        "only": 7,
        "linear.x.max_velocity": 3.0,
    }
    assert flat(file(text % "first.yaml").controllers["base"]) == {"k": 1, "only": 7}


def test_errors_in_a_params_file_are_reported_with_its_name(file, tmp_path):
    (tmp_path / "p.yaml").write_text("base:\n  ros__parameters:\n    rate: fast\n    rat: 1\n")
    read = file("controller_manager: {ros__parameters: {base: {type: a/B, params_file: p.yaml}}}\n")
    with pytest.raises(RobotConfigError, match=r"p\.yaml:3:11: base\.ros__parameters\.rate: expected a number"):
        read.controllers["base"].params.read(Some)
    assert "unknown key 'rat' (did you mean 'rate'?)" in read.controllers["base"].params.warnings[0]


def test_fallbacks_are_controllers_of_the_file(file):
    text = "controller_manager: {ros__parameters: {base: {type: a/B, fallback_controllers: %s}, safe: {type: a/B}}}\n"
    assert file(text % "[safe]").controllers["base"].fallbacks == ("safe",)
    assert file(text % "safe").controllers["base"].fallbacks == ("safe",)
    with pytest.raises(RobotConfigError, match=r"no controller 'saffe' \(did you mean 'safe'"):
        file(text % "[saffe]")


def test_where_a_block_stands_is_kept(file):
    read = file("/ns/base: {ros__parameters: {type: a/B}}\nrobot: {arm: {type: a/B, k: 1}}\n")
    assert [controller.namespace for controller in read.controllers.values()] == ["/ns", "/robot"]
    assert [controller.ros1 for controller in read.controllers.values()] == [False, True]
    assert read.controllers["arm"].params.line("k") == 2
    assert read.controllers["arm"].params.line("none") == 0


def test_blocks_of_gazebos_gains_have_no_effect_and_are_reported(file):
    read = file("gazebo_ros_control: {pid_gains: {l: {p: 1.0}}}\nbase: {type: a/B, k: 1}\n")
    assert list(read.controllers) == ["base"]
    assert "gazebo_ros_control has no effect" in read.warnings[0]


WILD = {
    "/**": "/**:\n  ros__parameters: {p: 1}\n",
    "/*": "/*:\n  ros__parameters: {p: 1}\n",
    "**": '"**":\n  ros__parameters: {p: 1}\n',
    "/robot/**": "/robot/**:\n  ros__parameters: {p: 1}\n",
    "/**/c": "/**/c:\n  ros__parameters: {p: 1}\n",
    "/*/c": "/*/c:\n  ros__parameters: {p: 1}\n",
    "/**: c": "/**:\n  c:\n    ros__parameters: {p: 1}\n",
    "/**: params and c": "/**:\n  ros__parameters: {q: 2}\n  c:\n    ros__parameters: {p: 1}\n",
    "/robot: /**: c": "/robot:\n  /**:\n    c:\n      ros__parameters: {p: 1}\n",
}


@pytest.mark.parametrize("text", WILD.values(), ids=WILD)
def test_a_block_with_wildcards_reaches_the_controller_wherever_it_is(file, text):
    read = file("controller_manager:\n  ros__parameters:\n    c: {type: x/Y}\n" + text)
    assert not read.warnings
    assert read.controllers["c"].params.flat.value["p"] == 1


@pytest.mark.parametrize(
    ("pattern", "namespace", "within"),
    [
        ("", "", True),
        ("", "/robot", False),
        ("/robot", "/robot", True),
        ("/robot", "/robot/arm", False),
        ("/**", "", True),
        ("/**", "/robot/arm", True),
        ("/*", "/robot", True),
        ("/*", "", False),
        ("/*", "/robot/arm", False),
        ("/robot/**", "/robot", True),
        ("/robot/**", "/other", False),
        ("/**/arm", "/robot/arm", True),
        ("/robot", "/**", True),
    ],
)
def test_wildcards_of_namespaces_are_those_of_rcl(pattern, namespace, within):
    assert is_within(pattern, namespace) is within


def test_what_a_block_for_all_nodes_reports_for_others_is_not_an_error_of_a_controller(file):
    text = "/**:\n  ros__parameters: {joints: [a], interface_name: velocity}\n"
    text += "controller_manager:\n  ros__parameters:\n    c: {type: x/Y}\n"
    params = file(text).controllers["c"].params
    params.read(CommonParams)
    assert params.warnings == []
    assert params.known >= {"update_rate", "use_sim_time"}


WITH_VARIABLES = """\
controller_manager:
  ros__parameters:
    wheels: {type: forward_command_controller/ForwardCommandController}
/<namespace>/wheels:
  ros__parameters:
    joints: ["$(var prefix)joint1"]  # $(var nothing) in a comment is none
    interface_name: $(var interface)
    other: $(var interface)
"""


def test_variables_of_a_launch_file_are_put_in_and_what_has_no_value_is_reported_once(tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text(WITH_VARIABLES)
    file = read_controllers(path, variables={"prefix": "left_", "namespace": "/one", "interface": "position"})
    assert file.warnings == []
    assert file.controllers["wheels"].namespace == "/one"
    warnings = read_controllers(path, variables={"prefix": "left_", "namespace": "/one"}).warnings
    assert len(warnings) == 1
    assert f"{path}:7:1: $(var interface) has no value; give it with --launch FILE NAME:=VALUE" in warnings[0]


@pytest.mark.parametrize(("value", "namespace"), [("/", ""), ("r1/", "/r1")])
def test_a_text_that_a_launch_file_replaces_is_replaced_as_it_stands(tmp_path, value, namespace):
    path = tmp_path / "c.yaml"
    path.write_text(re.sub(r"(?m)^(\w)", r"__namespace__/\1", JAZZY))
    file = read_controllers(path, variables={"__namespace__/": value})
    assert (file.namespace, file.controllers["base"].namespace, file.warnings) == (namespace, namespace, [])


def test_a_list_of_one_mapping_is_that_mapping(tmp_path):
    """As in the GPIO example of ros2_control_demos: rcl's parser of parameters takes it so."""
    path = tmp_path / "c.yaml"
    path.write_text(
        "controller_manager:\n  ros__parameters:\n    gpio: {type: gpio_controllers/GpioCommandController}\n"
        "gpio:\n  ros__parameters:\n    gpios: [flange]\n    command_interfaces:\n      flange:\n"
        "        - interfaces:\n          - vacuum\n"
    )
    keys = read_controllers(path).controllers["gpio"].params.flat.keys()
    assert "command_interfaces.flange.interfaces" in keys


@pytest.mark.parametrize(("first", "rate"), [("/**", 20), ("controller_manager", 10)])
def test_of_the_blocks_for_one_node_and_for_all_the_later_has_precedence(file, first, rate):
    blocks = {
        "/**": "/**: {ros__parameters: {update_rate: 10, command_timeout: 1.0}}\n",
        "controller_manager": "controller_manager: {ros__parameters: {update_rate: 20, c: {type: a/B}}}\n"
        "c: {ros__parameters: {command_timeout: 2.0}}\n",
    }
    control = file("".join(blocks[name] for name in sorted(blocks, key=lambda name: name != first)))
    assert control.update_rate == rate
    assert control.controllers["c"].params.flat.value["command_timeout"] == rate / 10


TYPED = "controller_manager: {ros__parameters: {c: {type: a/B}}}\n"


@pytest.mark.parametrize(
    ("text", "place"),
    [
        (TYPED + "c: {ros_parameters: {k: 1}}\n", "2:5: c.ros_parameters: unknown key 'ros_parameters'"),
        (
            "controller_manager: {ROS__Parameters: {c: {type: a/B}}}\n",
            "1:22: controller_manager.ROS__Parameters: unknown",
        ),
        (TYPED + "c: {ros__parameters: 5}\n", "2:22: c.ros__parameters: expected the parameters of a node"),
        (
            "controller_manager: {ros__parameters: [a]}\n",
            "1:39: controller_manager.ros__parameters: expected the param",
        ),
        ("- a\n", "1:1: expected a mapping of controllers"),
    ],
)
def test_a_block_without_parameters_is_one_error(file, text, place):
    with pytest.raises(RobotConfigError) as caught:
        file(text)
    assert f"c.yaml:{place}" in str(caught.value)
    assert "errors" not in str(caught.value)


def test_the_manager_may_be_in_the_block_for_all_nodes(file):
    read = file(
        "/**:\n  ros__parameters:\n    update_rate: 20\n    c: {type: a/B}\n    filter: {type: low}\n    k: 1\n"
    )
    assert (read.update_rate, [*read.controllers], read.warnings) == (20, ["c"], [])
    assert read.controllers["c"].params.flat.value["k"] == 1


@pytest.mark.parametrize(
    ("text", "warning"),
    [
        (
            "controller_manager: {ros__parameters: {c: {type: a/B}, d: {typ: a/B}}}\n",
            "no type, so it is not loaded (did you",
        ),
        ("controller_manager: {ros__parameters: {c: {type: a/B}, d: }}\n", "not loaded; give d: type: PACKAGE/CLASS"),
        (TYPED + "d: {k: 1, type: a/B}\n", "2:1: d: no ros__parameters (ROS 1), so ROS 2 refuses the file"),
        (TYPED + "c: {ros__parameters: {k: }}\n", "2:23: c.ros__parameters.k: no value, so the default applies"),
        (TYPED + "c: {ros__parameters: {type: a/C}}\n", "the type of c is 'a/B', given at"),
    ],
)
def test_what_ros_2_would_not_read_so_is_one_warning(file, text, warning):
    (found,) = file(text + "d: {ros__parameters: {k: 1}}\n" if "no type" in warning else text).warnings
    assert warning in found


DIFF_DRIVE = "diff_drive_controller/DiffDriveController"
MISSPELT = f"""\
controller_manager:
  ros__parameters:
    states: {{type: joint_state_broadcaster/JointStateBroadcaster}}
    base: {{type: {DIFF_DRIVE}}}
    forward: {{type: velocity_controllers/JointGroupVelocityController}}
forward: {{ros__parameters: {{joints: [l]}}}}
"""


@pytest.mark.parametrize(
    ("block", "name", "meant"),
    [
        ("bsae: {ros__parameters: {wheel_radius: 0.1}}", "bsae", "'base' (line 4)"),  # a similar name
        ("diff_cont: {ros__parameters: {wheel_radius: 0.1}}", "diff_cont", "'base' (line 4)"),  # its keys
        ("/robot/bsae: {ros__parameters: {k: 1}}", "bsae", "'base' (line 4)"),
        ("stetas: {ros__parameters: {frame_id: x}}", "stetas", "'states' (line 3)"),
    ],
)
def test_a_misspelt_block_is_one_error_with_both_names_and_read_for_its_controller(tmp_path, block, name, meant):
    path = tmp_path / "c.yaml"
    path.write_text(f"{MISSPELT}{block}\n")
    control, (problems, *_) = inspect_controllers(path)
    (error,) = problems.errors
    assert (error.line, error.column) == (7, 1)
    assert error.message == f"no controller is called {name!r}, and {meant} has no parameters; give both the same name"
    assert control.warnings == []
    assert any(flat(controller) for key, controller in control.controllers.items() if key != "forward")
    with pytest.raises(RobotConfigError, match=f"c.yaml:7:1: .*no controller is called '{name}'"):
        read_controllers(path)


@pytest.mark.parametrize("block", ["twist_mux: {ros__parameters: {use_sim_time: false, topics: {joy: {t: 1}}}}", ""])
def test_a_block_of_another_node_is_not_taken_for_that_of_a_controller(file, block):
    read = file(f"{MISSPELT}{block}\n")
    assert flat(read.controllers["base"]) == {}
    assert [text for text in read.warnings if "twist_mux" not in text] == []
