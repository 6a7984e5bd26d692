from canopen_control.commissioning.object_rows import LiveObject
from canopen_control.data_files import data_path
from canopen_control.od.eds import read_eds
from canopen_control.view.object_list import ObjectList

OD = read_eds(data_path("eds", "TMCM-1270.eds"), 3).od


def listed():
    return ObjectList(OD, 3)


def row(address):
    return next(item for item in listed().rows if item["a"] == address)


def live(**values):
    result = {(int(name[1:5], 16), 0): value for name, value in values.items()}
    return {
        address: (number, LiveObject(OD[address], value)) for number, (address, value) in enumerate(result.items(), 1)
    }


def test_an_object_has_its_name_unit_type_access_default_and_limits():
    speed = row("0x6081:00")
    assert (speed["name"], speed["unit"], speed["type"]) == ("Profile velocity", "counts/s", "UNSIGNED32")
    assert (speed["limits"], speed["fixed"], speed["sub"]) == ("0 to 4294967295", "", False)
    assert row("0x6040:00")["fixed"].startswith("moves the axis")
    assert row("0x6041:00")["fixed"] == "is read-only"
    identity = row("0x1018:01")
    assert (identity["object"], identity["name"], identity["sub"]) == ("Identity object", "Vendor-ID", True)


def test_a_search_has_the_words_of_the_verb():
    objects = listed()
    assert objects.search(" ") == (None, "")
    assert objects.search("0x6081") == (["0x6081:00"], "")
    result, _ = objects.search("velocity 0x1017")
    assert {"0x6081:00", "0x1017:00"} <= set(result)
    none, problem = objects.search("flux capacitor")
    assert none == []
    assert "no object 'flux'" in problem


def test_only_news_are_reported_and_in_words():
    objects, known = listed(), live(s1017=100, s6041=0x0637)
    news = objects.news(known)
    assert (news["0x1017:00"]["value"], news["0x1017:00"]["changed"]) == ("100", True)
    assert news["0x6041:00"]["meaning"].startswith("OPERATION ENABLED")
    assert (2, "operation enabled", True) in news["0x6041:00"]["bits"]
    assert {type(item) for item in news["0x6041:00"]["bits"]} == {tuple}  # what a page can be sent
    assert objects.news(known) == {}
    known[0x1017, 0] = 3, LiveObject(OD[0x1017, 0], None, "abort 0x06020000")
    assert objects.news(known) == {
        "0x1017:00": {"value": None, "meaning": None, "changed": False, "error": "abort 0x06020000", "bits": []}
    }


def test_what_comes_into_sight_is_reported_again():
    objects, known = listed(), live(s1017=100, s6041=0x0637)
    objects.news(known)
    assert list(objects.known(known, ["0x1017:00", "0x6083:00", "no address"])) == ["0x1017:00"]


def test_the_bits_of_a_statusword_are_those_of_the_mode_that_is_displayed():
    known = live(s6041=0x1637, s6061=3)
    assert (12, "speed is zero", True) in listed().news(known)["0x6041:00"]["bits"]


def test_the_mode_is_read_alongside_a_word_whose_bits_depend_on_it():
    objects = listed()
    assert [item.index for item in objects.entries_with_mode(["0x6041:00"])] == [0x6041, 0x6061]
    assert [item.index for item in objects.entries_with_mode(["0x6040:00", "0x6061:00"])] == [0x6040, 0x6061]
    assert [item.index for item in objects.entries_with_mode(["0x6081:00"])] == [0x6081]
