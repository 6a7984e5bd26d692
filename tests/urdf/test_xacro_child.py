from __future__ import annotations

import pytest
from urdf.test_xacro_run import HEAD, run_xacro, write

from canopen_control.urdf.xacro_child import _where, find_package


@pytest.mark.process
def test_find_looks_around_the_file_where_no_ros_knows_the_package(tmp_path):
    package = tmp_path / "src" / "my_robot"
    (package / "urdf").mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>my_description</name></package>", encoding="utf-8")
    (package / "part.xacro").write_text(f'{HEAD}<link name="part"/></robot>', encoding="utf-8")
    path = write(package / "urdf", '<xacro:include filename="$(find my_description)/part.xacro"/>')
    assert '<link name="part"/>' in run_xacro(path, {})
    assert find_package("my_robot", str(path)) == str(package)
    with pytest.raises(LookupError, match=r"package 'other' of \$\(find other\) is neither installed nor above"):
        find_package("other", str(path))


def test_of_a_long_macro_stack_the_first_lines_are_told():
    assert _where("") == ""
    assert _where("\x1b[31mwhen instantiating macro: m\x1b[0m\n\n in file: x\n") == (
        " (when instantiating macro: m; in file: x)"
    )
    assert _where("line\n" * 900) == " (line; line; line; line; line; ...)"
