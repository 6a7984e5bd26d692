import os
import stat

import pytest

from canopen_control.host.sockets import runtime_dir
from canopen_control.view.page_address import AccessRules, PageAddress, killed_port, page_addresses

pytestmark = pytest.mark.usefixtures("private_folders")


def serve(robot="robby", port=8080, host="127.0.0.1"):
    """Do what a view does when it has bound its port; returns its file and its rules."""
    address = PageAddress(robot, host, port)
    rules = AccessRules(host, port, address.token)
    address.keep(rules)
    return address, rules


def kill(address):
    """Leave the file as a process does that is killed: the kernel closes it, and nobody removes it."""
    os.close(address._fd)
    address._fd = -1


def files():
    return sorted(path.name for path in runtime_dir().glob("page-*"))


def test_the_address_is_for_its_user_alone():
    address, rules = serve()
    assert page_addresses("robby") == page_addresses() == {"http://127.0.0.1:8080/": rules.url}
    assert page_addresses("other") == {}
    (name,) = files()
    assert stat.S_IMODE((runtime_dir() / name).stat().st_mode) == 0o600
    address.end()
    assert (files(), page_addresses()) == ([], {})


def test_a_view_that_was_killed_is_followed_by_one_with_its_token():
    address, rules = serve()
    kill(address)
    assert page_addresses() == {}
    after, again = serve()
    assert again.url == rules.url
    after.end()


def test_after_an_end_in_order_the_old_token_opens_nothing():
    address, rules = serve()
    address.end()
    assert serve()[1].token != rules.token


@pytest.mark.parametrize("other", [{"port": 8081}, {"robot": "other"}, {"host": "0.0.0.0"}])
def test_a_token_belongs_to_one_robot_host_and_port(other):
    address, rules = serve()
    kill(address)
    assert serve(**other)[1].token != rules.token


def test_a_dead_view_on_another_port_is_cleared_away_and_a_living_one_is_not():
    living, dead = serve(port=8080), serve(port=8081)
    kill(dead[0])
    serve(port=8082)
    assert files() == ["page-robby-127.0.0.1-8080.json", "page-robby-127.0.0.1-8082.json"]
    assert living[1].url in page_addresses().values()


def test_while_one_holds_the_file_another_has_a_token_of_its_own():
    _first, rules = serve()
    second, others = serve()
    assert others.token != rules.token
    second.end()
    assert page_addresses() == {rules.place: rules.url}


@pytest.mark.parametrize("text", ["", "{", "[]", "4711\n", '{"token": 5}', '{"token": "short"}', '{"token": "../etc"}'])
def test_what_is_no_file_of_ours_gives_no_token(text):
    (runtime_dir() / "page-robby-127.0.0.1-8080.json").write_text(text)
    assert PageAddress("robby", "127.0.0.1", 8080).token is None


def test_a_link_in_its_place_is_not_followed(tmp_path):
    from canopen_control.errors import ConfigError

    (runtime_dir() / "page-robby-127.0.0.1-8080.json").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ConfigError, match="symbolic link"):
        PageAddress("robby", "127.0.0.1", 8080)
    assert page_addresses() == {}


def test_a_view_goes_on_where_the_one_before_was_killed():
    address, _ = serve(port=8085)
    assert killed_port("robby", "127.0.0.1") is None  # it runs
    kill(address)
    assert killed_port("robby", "127.0.0.1") == 8085
    assert killed_port("robby", "0.0.0.0") is None
    assert killed_port("rob", "127.0.0.1") is None
