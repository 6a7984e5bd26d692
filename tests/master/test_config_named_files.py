"""The files that bus.yml names: where they are sought, and what they download."""

import shutil

import pytest

from canopen_control.data_files import data_path
from canopen_control.errors import EdsError
from canopen_control.master.config import NotFound, Sources
from canopen_control.od.dcf import encode_concise, write_dcf
from canopen_control.od.eds import read_eds

EDS = data_path("eds", "TMCM-1270.eds")


def test_a_file_is_sought_in_the_nodes_path_the_files_path_beside_bus_yml_and_among_the_bundled(tmp_path, monkeypatch):
    sources = Sources(tmp_path, "@BUS_CONFIG_PATH@/general")
    assert sources.find("TMCM-1270.eds") == EDS
    places = [tmp_path, tmp_path / "general", tmp_path / "own"]
    monkeypatch.setenv("OWN_FILES", str(places[2]))
    for place in places:
        place.mkdir(exist_ok=True)
        shutil.copy(EDS, place)
        assert sources.find("TMCM-1270.eds", "$OWN_FILES") == place / "TMCM-1270.eds"


def test_a_missing_file_names_the_places_and_a_variable_that_is_not_set(tmp_path, monkeypatch):
    monkeypatch.delenv("NOT_SET", raising=False)
    with pytest.raises(NotFound, match=f"no file 'x.eds'; sought in .*{tmp_path}"):
        Sources(tmp_path).find("x.eds")
    with pytest.raises(NotFound, match="variable of the environment is not set"):
        Sources(tmp_path, "$NOT_SET/eds").find("x.eds")


def test_one_file_serves_many_nodes_with_their_own_ids(tmp_path):
    sources = Sources(tmp_path)
    assert sources.dictionary(EDS, 3)[0x1800, 1].default == 0x40000183
    assert sources.dictionary(EDS, 5)[0x1800, 1].default == 0x40000185
    assert sources.dictionary(EDS, 3) is sources.dictionary(EDS, 3)
    assert list(sources.issues) == [EDS]
    with pytest.raises(EdsError):
        sources.dictionary(data_path("config", "robby") / "bus.yml", 3)


def test_a_concise_dcf_and_the_parameter_values_of_a_dcf_are_downloads(tmp_path):
    sources = Sources(tmp_path)
    (tmp_path / "left.bin").write_bytes(encode_concise([(0x6083, 0, b"\x01\0\0\0"), (0x2000, 0, b"\x03")]))
    assert sources.downloads("left.bin", "", 3) == ((0x6083, 0, b"\x01\0\0\0"), (0x2000, 0, b"\x03"))
    write_dcf(tmp_path / "left.dcf", read_eds(EDS).od, 3, 1_000_000, {(0x6083, 0): 7, (0x2000, 0): 2})
    assert sources.downloads("left.dcf", "", 3) == ((0x2000, 0, b"\x02"), (0x6083, 0, b"\x07\0\0\0"))


def test_a_concise_dcf_that_is_cut_short_is_refused(tmp_path):
    (tmp_path / "left.bin").write_bytes(encode_concise([(0x6083, 0, b"\x01\0\0\0")])[:-1])
    with pytest.raises(ValueError, match="3 of its 4 bytes"):
        Sources(tmp_path).downloads("left.bin", "", 3)
