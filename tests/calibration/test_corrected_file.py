import shutil
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from canopen_control.calibration.corrected_file import Change, given_in, write_corrected
from canopen_control.controllers.controllers_file import read_controllers
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, DiskFull

SEPARATION, LEFT, RIGHT = NAMES = (
    "wheel_separation_multiplier", "left_wheel_radius_multiplier", "right_wheel_radius_multiplier"
)  # fmt: skip
VALUES = {SEPARATION: 1.0175, LEFT: 0.9975, RIGHT: 1.0025}
HEAD = "controller_manager: {ros__parameters: {base: {type: diff_drive_controller/DiffDriveController}}}\n"


def written(tmp_path, text, values=None):
    path, copy = tmp_path / "controllers.yaml", tmp_path / "copy.yaml"
    path.write_bytes(text.encode())
    changes = write_corrected(path, copy, "base", VALUES if values is None else values)
    assert path.read_bytes() == text.encode(), "the file itself stays"
    return copy.read_bytes().decode(), changes


def test_values_that_are_there_are_changed_and_nothing_else(tmp_path):
    text = HEAD + (
        "base:  # of robby\n  ros__parameters:\n    wheel_separation: 0.24   # m\n"
        "    left_wheel_radius_multiplier: 1.0   # measured\n    wheel_separation_multiplier: 1  # too\n"
        "    right_wheel_radius_multiplier:   1.001\n    linear.x: {max_velocity: 1.0}  # kept\n"
    )
    copy, changes = written(tmp_path, text)
    assert copy == text.replace("_multiplier: 1.0 ", "_multiplier: 0.9975 ").replace("r: 1  #", "r: 1.0175  #").replace(
        "1.001", "1.0025"
    )
    assert changes == [
        Change(SEPARATION, 1.0, 1.0175, 6),
        Change(LEFT, 1.0, 0.9975, 5),
        Change(RIGHT, 1.001, 1.0025, 7),
    ]
    assert str(changes[0]) == "line 6: wheel_separation_multiplier: 1 -> 1.0175"


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_values_that_are_not_there_are_put_alongside_the_wheels(tmp_path, end):
    text = (HEAD + "base:\n  ros__parameters:\n    # the wheels\n    wheel_separation: 0.24\n    x: 1").replace(
        "\n", end
    )
    copy, changes = written(tmp_path, text)
    added = "".join(f"    {name}: {value}{end}" for name, value in VALUES.items())
    assert copy == text.replace("    wheel_separation", added + "    wheel_separation")
    assert [change.before for change in changes] == [None] * 3
    assert str(changes[0]) == f"line {changes[0].line}: wheel_separation_multiplier: not given -> 1.0175"
    assert "wheel_separation_multiplier" in copy.splitlines()[changes[0].line - 1]


def test_a_block_in_braces_is_changed_too(tmp_path):
    text = HEAD + "base: {ros__parameters: {wheel_separation: 0.24, left_wheel_radius_multiplier: 1.0}}  # short\n"
    copy, _ = written(tmp_path, text)
    assert copy.endswith("wheel_separation: 0.24, left_wheel_radius_multiplier: 0.9975}}  # short\n")
    assert given_in(tmp_path / "copy.yaml", "base", NAMES) == VALUES


def test_bundled_robots_files_can_be_copied(tmp_path):
    path = data_path("config", "robby") / "ros2_controllers.yaml"
    write_corrected(path, tmp_path / "copy.yaml", "robby_base_controller", VALUES)
    assert given_in(path, "robby_base_controller", NAMES) == dict.fromkeys(NAMES)
    assert given_in(tmp_path / "copy.yaml", "robby_base_controller", NAMES) == VALUES
    kept = [line for line in (tmp_path / "copy.yaml").read_text().splitlines() if "multiplier" not in line]
    assert kept == path.read_text().splitlines()


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(values=st.fixed_dictionaries(dict.fromkeys(NAMES, st.floats(0.5, 2.0))), given_one=st.booleans())
def test_whatever_the_values_are_the_copy_reports_them(tmp_path, values, given_one):
    more = "\n    right_wheel_radius_multiplier: 1.0" if given_one else ""
    text = HEAD + f"base:\n  ros__parameters:\n    left_wheel_names: [l]{more}\n"
    written(tmp_path, text, values)
    config = read_controllers(tmp_path / "copy.yaml").controllers["base"]
    for name, value in values.items():
        assert config.params.flat.get(name).value == pytest.approx(value, rel=1e-8)


def test_a_controller_that_is_not_there_is_reported(tmp_path):
    (tmp_path / "a.yaml").write_text(HEAD + "base: {ros__parameters: {wheel_radius: 1.0}}\n")
    with pytest.raises(ConfigError, match=r"a.yaml has no controller 'bass'.*base"):
        write_corrected(tmp_path / "a.yaml", tmp_path / "b.yaml", "bass", VALUES)


def test_a_value_that_is_not_a_number_is_reported_with_its_place(tmp_path):
    (tmp_path / "a.yaml").write_text(HEAD + f"base: {{ros__parameters: {{wheel_radius: 1.0, {LEFT}: true}}}}\n")
    for work in (
        lambda: write_corrected(tmp_path / "a.yaml", tmp_path / "b.yaml", "base", VALUES),
        lambda: given_in(tmp_path / "a.yaml", "base", NAMES),
    ):
        with pytest.raises(ConfigError, match=rf"a\.yaml:2:\d+: {LEFT} is not a number"):
            work()
    assert not (tmp_path / "b.yaml").exists()


def test_the_file_itself_is_never_written(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text(HEAD + "base: {ros__parameters: {wheel_radius: 1.0}}\n")
    with pytest.raises(ConfigError, match="is the robot's own file"):
        write_corrected(path, tmp_path / "." / "a.yaml", "base", VALUES)
    with pytest.raises(ConfigError, match="cannot be written: No such file or directory"):
        write_corrected(path, tmp_path / "none" / "a.yaml", "base", VALUES)


def test_a_full_disk_is_no_mistake_of_the_user(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text(HEAD + "base: {ros__parameters: {wheel_radius: 1.0}}\n")
    with pytest.raises(DiskFull, match="/dev/full: No space left on device"):
        write_corrected(path, Path("/dev/full"), "base", VALUES)


def test_values_of_a_params_file_are_commanded_to_stand_there(tmp_path):
    (tmp_path / "more.yaml").write_text("base: {ros__parameters: {left_wheel_radius_multiplier: 1.0}}\n")
    (tmp_path / "a.yaml").write_text(
        "controller_manager: {ros__parameters: {base: {type: diff_drive_controller/DiffDriveController, "
        "params_file: more.yaml}}}\nbase: {ros__parameters: {wheel_radius: 1.0}}\n"
    )
    with pytest.raises(ConfigError, match=r"is set in .*more.yaml:1, a params_file of .*a.yaml"):
        write_corrected(tmp_path / "a.yaml", tmp_path / "b.yaml", "base", VALUES)
    assert not (tmp_path / "b.yaml").exists()


def test_a_base_that_names_no_wheels_is_reported_with_what_to_write(tmp_path):
    (tmp_path / "a.yaml").write_text(HEAD)
    with pytest.raises(ConfigError, match=r"write wheel_separation_multiplier: 1.0175 by hand"):
        write_corrected(tmp_path / "a.yaml", tmp_path / "b.yaml", "base", VALUES)


def test_a_layout_in_which_one_value_is_reported_for_two_is_refused_and_no_copy_is_left(tmp_path):
    text = HEAD + (
        "base:\n  ros__parameters:\n    left_wheel_radius_multiplier: &one 1.0\n"
        "    right_wheel_radius_multiplier: *one\n    wheel_radius: 1.0\n"
    )
    with pytest.raises(ConfigError, match=r"the copy could not be read and was deleted"):
        written(tmp_path, text)
    assert not (tmp_path / "copy.yaml").exists()
    shutil.rmtree(tmp_path)
