from canopen_control.data_files import data_names, data_path


def test_the_bundled_robot_and_its_eds_are_there():
    assert "robby" in data_names("config")
    assert "TMCM-1270.eds" in data_names("eds")
    assert data_path("config", "robby").is_dir()
    assert data_path("eds", "TMCM-1270.eds").is_file()


def test_what_is_not_bundled_has_a_path_that_does_not_exist():
    assert not data_path("eds", "nothing.eds").exists()
    assert data_names("nothing") == []
