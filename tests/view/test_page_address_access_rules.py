import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.view.page_address import AccessRules, is_loopback

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
def test_whoever_else_asks_is_refused_with_the_token_too(rules, headers):
    assert ask(rules, **headers) is not None
    assert ask(rules, **(WS | headers)) is not None


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "::1", "0.0.0.0", "192.168.1.5"])
def test_every_address_has_a_token_of_its_own_loopback_too(host):
    first, second = AccessRules(host, 1), AccessRules(host, 1)
    assert len(first.token) == 32
    assert first.token != second.token
    assert first.url == f"{first.place}{first.token}/"
    assert first.token not in first.place


def test_the_address_is_where_the_server_is():
    assert AccessRules("127.0.0.1", 1, "t").url == "http://127.0.0.1:1/t/"
    assert AccessRules("::1", 1, "t").url == "http://[::1]:1/t/"


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


def test_a_cookie_or_a_header_opens_nothing(rules):
    for headers in ({"Cookie": "canopen_control_8080=secret"}, {"Authorization": "Bearer secret"}):
        assert "token" in ask(rules, "/", **headers)


def test_another_host_name_is_for_addresses_that_other_computers_reach(rules, open_door):
    assert ask(rules, Host="robot.example:8080") is not None
    assert ask(open_door, Host="robot.example:8080") is None


def test_the_page_may_ask_nobody_else_and_be_framed_by_nobody(rules):
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


def test_what_changes_something_says_where_it_comes_from(rules):
    assert "POST without Origin" in rules.refusal("/secret/stop", {"Host": OWN}, "POST")
    assert rules.refusal("/secret/stop", {"Host": OWN, "Origin": f"http://{OWN}"}, "POST") is None


def test_another_page_may_lead_here_but_not_use_what_is_here(rules):
    foreign = {"Sec-Fetch-Site": "cross-site"}
    assert ask(rules, **foreign, **{"Sec-Fetch-Mode": "navigate"}) is None
    assert ask(rules, **foreign, **{"Sec-Fetch-Mode": "no-cors"}) is not None
    assert ask(rules, **{"Sec-Fetch-Site": "same-origin", "Sec-Fetch-Mode": "cors"}) is None
