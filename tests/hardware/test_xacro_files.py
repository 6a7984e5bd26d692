from __future__ import annotations

import pytest

from canopen_control.errors import RobotConfigError
from canopen_control.hardware.xacro_files import find_package, run_xacro

HEAD = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="r">'


def write(folder, text: str, name: str = "r.urdf.xacro"):
    path = folder / name
    path.write_text(f"{HEAD}{text}</robot>", encoding="utf-8")
    return path


def test_arguments_macros_and_includes_work(tmp_path):
    write(tmp_path, '<xacro:macro name="m" params="n"><link name="${n}_${2 * 3}"/></xacro:macro>', "m.xacro")
    path = write(
        tmp_path, '<xacro:arg name="who" default="left"/><xacro:include filename="m.xacro"/><xacro:m n="$(arg who)"/>'
    )
    assert '<link name="left_6"/>' in run_xacro(path, {})
    assert '<link name="right_6"/>' in run_xacro(path, {"who": "right"})


def test_find_looks_around_the_file_where_no_ros_knows_the_package(tmp_path):
    package = tmp_path / "src" / "my_robot"
    (package / "urdf").mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>my_description</name></package>", encoding="utf-8")
    (package / "part.xacro").write_text(f'{HEAD}<link name="part"/></robot>', encoding="utf-8")
    path = write(package / "urdf", '<xacro:include filename="$(find my_description)/part.xacro"/>')
    assert '<link name="part"/>' in run_xacro(path, {})
    assert find_package("my_robot", path) == str(package)
    with pytest.raises(RobotConfigError, match=r"package 'other' of \$\(find other\) is neither installed nor above"):
        find_package("other", path)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ('<link name="${unknown}"/>', "unknown"),
        ('<xacro:include filename="none.xacro"/>', "none.xacro"),
        ("<xacro:nothing/>", "nothing"),
        ('<link name="${1 / 0}"/>', "division by zero"),
        ("<link>", "mismatched tag"),
        ('<link name="$(find no_such_package_here)"/>', "no_such_package_here"),
        ('<link name="$(arg missing)"/>', "missing"),
    ],
)
def test_whatever_xacro_refuses_is_one_error_with_the_file(tmp_path, text, wanted):
    path = write(tmp_path, text)
    with pytest.raises(RobotConfigError, match=wanted) as caught:
        run_xacro(path, {})
    assert str(caught.value).startswith(f"{path}: xacro: ")
