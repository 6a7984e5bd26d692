import os
import stat

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.host.sockets import runtime_dir
from canopen_control.view.page_address import AccessRules, PageAddress, is_loopback, killed_port, page_addresses

OWN = "127.0.0.1:8080"
WS = {"Upgrade": "websocket"}


def ask(rules, path="/secret/", **headers):
    return rules.refusal(path, {"Host": OWN, **headers})


@pytest.fixture
def rules():
    return AccessRules("127.0.0.1", 8080, "secret")


@pytest.fixture
def open_door():
    return AccessRules("0.0.0.0", 8080, "secret")


def test_the_page_and_its_own_socket_come_in(rules):
    assert ask(rules) is None
    assert ask(rules, "/secret") is None
    assert ask(rules, "/secret/_nicegui_ws/", **WS, Origin=f"http://{OWN}") is None
    assert ask(rules, **WS, Host="localhost:8080", Origin="http://localhost:8080") is None


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "https://127.0.0.1:8080"},
        {"Origin": "http://127.0.0.1:8081"},
        {"Origin": "http://localhost:8080"},  # another origin than the Host that is asked
        {"Host": "evil.example:8080", "Origin": "http://evil.example:8080"},  # a name that was pointed at us
        {"Host": ""},
        WS,
    ],
)
def test_another_user_is_refused_even_with_the_token(rules, headers):
    assert ask(rules, **headers) is not None
    assert ask(rules, **(WS | headers)) is not None


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "::1", "0.0.0.0", "192.168.1.5"])
def test_every_address_has_a_token_of_its_own_loopback_too(host):
    first, second = AccessRules(host, 1), AccessRules(host, 1)
    assert len(first.token) == 32
    assert first.token != second.token
    assert first.url == f"{first.place}{first.token}/"
    assert first.token not in first.place


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
@pytest.mark.parametrize(
    "path",
    ["/", "", "secret/", "//secret/", "/x/../secret/", "/secretx/", "/secre/", "/SECRET/", "/?token=secret",
     "/ secret/", "/stop", "/mesh/1.stl", "/_nicegui/3.18.0/static/nicegui.js", "/_nicegui_ws/socket.io/", "/\ud800/"],
)  # fmt: skip
def test_without_the_token_nothing_is_answered(host, path):
    rules = AccessRules(host, 8080, "secret")
    assert "token" in ask(rules, path)
    assert "token" in ask(rules, path, **WS, Origin=f"http://{OWN}")
    assert "token" in rules.refusal(path, {"Host": OWN, "Origin": f"http://{OWN}"}, "POST")


def test_another_host_name_is_for_addresses_that_other_computers_reach(rules, open_door):
    assert ask(rules, Host="robot.example:8080") is not None
    assert ask(open_door, Host="robot.example:8080") is None


def test_the_page_loads_from_no_other_origin_and_cannot_be_framed(rules):
    headers = rules.response_headers()
    assert "default-src 'self'" in headers["Content-Security-Policy"]
    assert "script-src 'none'" in headers["Content-Security-Policy"]
    assert "script-src 'self' 'nonce-abc' 'unsafe-eval';" in rules.response_headers("abc")["Content-Security-Policy"]
    assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
    assert headers["Referrer-Policy"] == "no-referrer"


@pytest.mark.parametrize(
    ("host", "expected"),
    [("127.0.0.1", True), ("127.5.5.5", True), ("::1", True), ("localhost", True), ("0.0.0.0", False), ("", False),
     ("10.0.0.1", False), ("robot.local", False)],
)  # fmt: skip
def test_what_is_loopback(host, expected):
    assert is_loopback(host) is expected


@given(st.text(max_size=50), st.text(max_size=50), st.text(max_size=50))
def test_no_header_and_no_path_raises_or_comes_in_by_chance(path, origin, cookie):
    rules = AccessRules("0.0.0.0", 8080, "secret")
    if "secret" not in path:
        assert rules.refusal(path, {"Host": OWN, "Origin": origin, "Cookie": cookie}) is not None


def test_what_changes_something_reports_where_it_comes_from(rules):
    assert "POST without Origin" in rules.refusal("/secret/stop", {"Host": OWN}, "POST")
    assert rules.refusal("/secret/stop", {"Host": OWN, "Origin": f"http://{OWN}"}, "POST") is None


def test_another_page_may_lead_here_but_not_use_what_is_here(rules):
    foreign = {"Sec-Fetch-Site": "cross-site"}
    assert ask(rules, **foreign, **{"Sec-Fetch-Mode": "navigate"}) is None
    assert ask(rules, **foreign, **{"Sec-Fetch-Mode": "no-cors"}) is not None
    assert ask(rules, **{"Sec-Fetch-Site": "same-origin", "Sec-Fetch-Mode": "cors"}) is None


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


@pytest.mark.usefixtures("private_folders")
def test_the_address_is_for_its_user_alone():
    address, rules = serve()
    assert page_addresses("robby") == page_addresses() == {"http://127.0.0.1:8080/": rules.url}
    assert page_addresses("other") == {}
    (name,) = files()
    assert stat.S_IMODE((runtime_dir() / name).stat().st_mode) == 0o600
    address.end()
    assert (files(), page_addresses()) == ([], {})


@pytest.mark.usefixtures("private_folders")
def test_a_view_that_was_killed_is_followed_by_one_with_its_token():
    address, rules = serve()
    kill(address)
    assert page_addresses() == {}
    after, again = serve()
    assert again.url == rules.url
    after.end()


@pytest.mark.usefixtures("private_folders")
@pytest.mark.parametrize("other", [{"port": 8081}, {"robot": "other"}, {"host": "0.0.0.0"}])
def test_a_token_belongs_to_one_robot_host_and_port(other):
    address, rules = serve()
    kill(address)
    assert serve(**other)[1].token != rules.token


@pytest.mark.usefixtures("private_folders")
def test_a_dead_view_on_another_port_is_cleared_away_and_a_living_one_is_not():
    living, dead = serve(port=8080), serve(port=8081)
    kill(dead[0])
    serve(port=8082)
    assert files() == ["page-robby-127.0.0.1-8080.json", "page-robby-127.0.0.1-8082.json"]
    assert living[1].url in page_addresses().values()


@pytest.mark.usefixtures("private_folders")
def test_while_one_holds_the_file_another_has_a_token_of_its_own():
    _first, rules = serve()
    second, others = serve()
    assert others.token != rules.token
    second.end()
    assert page_addresses() == {rules.place: rules.url}


@pytest.mark.usefixtures("private_folders")
@pytest.mark.parametrize("text", ["", "{", "[]", "4711\n", '{"token": 5}', '{"token": "short"}', '{"token": "../etc"}'])
def test_what_is_not_a_file_of_ours_gives_no_token(text):
    (runtime_dir() / "page-robby-127.0.0.1-8080.json").write_text(text)
    assert PageAddress("robby", "127.0.0.1", 8080).token is None


@pytest.mark.usefixtures("private_folders")
def test_a_link_in_its_place_is_not_followed(tmp_path):
    from canopen_control.errors import ConfigError

    (runtime_dir() / "page-robby-127.0.0.1-8080.json").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ConfigError, match="symbolic link"):
        PageAddress("robby", "127.0.0.1", 8080)
    assert page_addresses() == {}


@pytest.mark.usefixtures("private_folders")
def test_a_view_continues_where_the_one_before_was_killed():
    address, _ = serve(port=8085)
    assert killed_port("robby", "127.0.0.1") is None  # it runs
    kill(address)
    assert killed_port("robby", "127.0.0.1") == 8085
    assert killed_port("robby", "0.0.0.0") is None
    assert killed_port("rob", "127.0.0.1") is None
