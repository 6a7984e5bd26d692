"""ROS packages by name: around a file, in ROS_PACKAGE_PATH, where ament installs them."""

import os

import pytest

from canopen_control.urdf.package_search import find_package, installed_packages, package_folders


def package(folder, name=None):
    """Make a package, whose manifest has another name than its folder where one is given."""
    folder.mkdir(parents=True)
    (folder / "package.xml").write_text(f"<package><name>{name or folder.name}</name></package>", encoding="utf-8")
    return folder


def beside(folder):
    (folder / "urdf").mkdir()
    return str(folder / "urdf" / "r.urdf.xacro")


def test_the_package_that_a_file_is_in_is_found_by_its_folder_and_by_its_manifest(tmp_path):
    own = package(tmp_path / "src" / "my_robot", "my_description")
    file = beside(own)
    assert find_package("my_robot", file, {}) == str(own)
    assert find_package("my_description", file, {}) == str(own)


def test_a_package_beside_it_is_found_too_whatever_its_folder_is_called(tmp_path):
    file = beside(package(tmp_path / "src" / "my_robot"))
    other = package(tmp_path / "src" / "parts_of_it", "parts")
    assert find_package("parts", file, {}) == str(other)


def test_sources_go_before_what_is_installed(tmp_path):
    own = package(tmp_path / "src" / "my_robot")
    (tmp_path / "install" / "share" / "my_robot").mkdir(parents=True)
    environment = {"AMENT_PREFIX_PATH": str(tmp_path / "install")}
    assert find_package("my_robot", beside(own), environment) == str(own)
    there = [str(each) for each in package_folders("my_robot", tmp_path / "x.xacro", environment)]
    assert there == [str(tmp_path / "install" / "share" / "my_robot")]


def test_ros_package_path_is_searched_in_depth_and_ends_at_a_manifest(tmp_path):
    found = package(tmp_path / "ws" / "group" / "deep" / "wheels")
    package(tmp_path / "ws" / "outer")
    package(tmp_path / "ws" / "outer" / "inner")
    package(tmp_path / "ws" / ".hidden" / "secret")
    environment = {"ROS_PACKAGE_PATH": f"{tmp_path / 'nothing'}{os.pathsep}{tmp_path / 'ws'}"}
    assert list(installed_packages("wheels", environment)) == [found]
    assert list(installed_packages("inner", environment)) == []
    assert list(installed_packages("secret", environment)) == []


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "/"])
def test_what_is_no_name_is_no_package(tmp_path, name):
    (tmp_path / "share").mkdir()
    environment = {"AMENT_PREFIX_PATH": str(tmp_path), "ROS_PACKAGE_PATH": str(tmp_path)}
    assert list(package_folders(name, tmp_path / "x", environment)) == []


def test_one_that_is_nowhere_says_what_to_do(tmp_path):
    with pytest.raises(
        LookupError, match=r"'other' of \$\(find other\) is neither installed nor above .*; add the folder"
    ):
        find_package("other", str(tmp_path / "x.xacro"), {})
