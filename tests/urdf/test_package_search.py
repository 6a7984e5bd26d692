"""ROS packages by name: around a file, in ROS_PACKAGE_PATH, where ament installs them."""

import os
from pathlib import Path

import pytest

from canopen_control.urdf.package_search import find_package, installed_file, installed_packages, package_folders


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


def test_a_package_next_to_it_is_found_too_whatever_its_folder_is_called(tmp_path):
    file = beside(package(tmp_path / "src" / "my_robot"))
    other = package(tmp_path / "src" / "parts_of_it", "parts")
    assert find_package("parts", file, {}) == str(other)


@pytest.mark.rest
def test_sources_go_before_what_is_installed(tmp_path):
    own = package(tmp_path / "src" / "my_robot")
    (tmp_path / "install" / "share" / "my_robot").mkdir(parents=True)
    environment = {"AMENT_PREFIX_PATH": str(tmp_path / "install")}
    assert find_package("my_robot", beside(own), environment) == str(own)
    there = [str(folder) for folder in package_folders("my_robot", tmp_path / "x.xacro", environment)]
    assert there == [str(tmp_path / "install" / "share" / "my_robot")]


def test_ros_package_path_is_searched_in_depth_and_ends_at_a_manifest(tmp_path):
    result = package(tmp_path / "ws" / "group" / "deep" / "wheels")
    package(tmp_path / "ws" / "outer")
    package(tmp_path / "ws" / "outer" / "inner")
    package(tmp_path / "ws" / ".hidden" / "secret")
    environment = {"ROS_PACKAGE_PATH": f"{tmp_path / 'nothing'}{os.pathsep}{tmp_path / 'ws'}"}
    assert list(installed_packages("wheels", environment)) == [result]
    assert list(installed_packages("inner", environment)) == []
    assert list(installed_packages("secret", environment)) == []


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "/"])
def test_what_is_not_a_name_is_not_a_package(tmp_path, name):
    (tmp_path / "share").mkdir()
    environment = {"AMENT_PREFIX_PATH": str(tmp_path), "ROS_PACKAGE_PATH": str(tmp_path)}
    assert list(package_folders(name, tmp_path / "x", environment)) == []


@pytest.mark.rest
def test_one_that_is_nowhere_suggests_what_to_do(tmp_path):
    with pytest.raises(
        LookupError, match=r"'other' of \$\(find other\) is neither installed nor above .*; add the folder"
    ):
        find_package("other", str(tmp_path / "x.xacro"), {})


@pytest.mark.parametrize(
    ("name", "where"),
    [
        ("urdf/a.xacro", "description/urdf/a.xacro"),
        ("config/deep/b.yaml", "bringup/config/deep/b.yaml"),
        ("here/c.yaml", "here/c.yaml"),  # below the package itself
        ("all/d.yaml", "loose/d.yaml"),  # a folder that ends in / is installed without its own name
        ("gone/e.yaml", "gone/e.yaml"),  # nothing installs it: the name is returned as it is
        ("commented/f.yaml", "commented/f.yaml"),
    ],
)
def test_a_file_lies_where_the_sources_have_what_cmake_installs(tmp_path, name, where):
    (tmp_path / "CMakeLists.txt").write_text(
        "install(DIRECTORY description/urdf\n  DESTINATION share/p)\n"
        'INSTALL( DIRECTORY "bringup/config" DESTINATION share/${PROJECT_NAME} )\n'
        "install(DIRECTORY loose/ DESTINATION share/p/all)\n"
        "install(DIRECTORY include DESTINATION include)\n"
        "install(TARGETS lib DESTINATION lib)\n"
        "# install(DIRECTORY x/commented DESTINATION share/p)\n"
    )
    for item in (
        "description/urdf/a.xacro",
        "bringup/config/deep/b.yaml",
        "here/c.yaml",
        "loose/d.yaml",
        "x/commented/f.yaml",
    ):
        (tmp_path / item).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / item).touch()
    assert installed_file(tmp_path, Path(name)) == tmp_path / where
