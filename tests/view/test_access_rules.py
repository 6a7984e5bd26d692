import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.view.access_rules import AccessRules, is_loopback

OWN = "127.0.0.1:8080"
WS = {"Upgrade": "websocket"}


def ask(rules, path="/", **headers):
    return rules.refusal(path, {"Host": OWN, **headers})


@pytest.fixture
def rules():
    return AccessRules("127.0.0.1", 8080)


@pytest.fixture
def open_door():
    return AccessRules("0.0.0.0", 8080, "secret")


def test_the_page_and_its_own_socket_come_in(rules):
    assert ask(rules) is None
    assert ask(rules, **WS, Origin=f"http://{OWN}") is None
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
def test_whoever_else_asks_is_refused(rules, headers):
    assert ask(rules, **headers) is not None
    assert ask(rules, **(WS | headers)) is not None


def test_loopback_needs_no_token_and_everything_else_has_one():
    assert AccessRules("127.0.0.1", 1).token is None
    assert AccessRules("127.0.0.1", 1).url == "http://127.0.0.1:1/"
    first, second = AccessRules("0.0.0.0", 1), AccessRules("192.168.1.5", 1)
    assert first.token
    assert first.token != second.token
    assert second.url == f"http://192.168.1.5:1/?token={second.token}"


def test_without_the_token_nobody_comes_in(open_door):
    for path in ("/", "/?token=", "/?token=wrong", "/?token=secre%74x"):
        assert "token" in ask(open_door, path)
    assert "token" in ask(open_door, **WS, Origin=f"http://{OWN}")
    assert "token" in ask(open_door, Cookie="canopen_control_8080=wrong")
    assert "token" in ask(open_door, Cookie="canopen_control_9090=secret")


def test_the_token_opens_the_page_and_its_cookie_the_socket(open_door):
    assert ask(open_door, "/?token=secret") is None
    cookie = open_door.response_headers("/?token=secret")["Set-Cookie"]
    assert {"HttpOnly", "SameSite=Strict"} <= {part.strip() for part in cookie.split(";")}
    assert ask(open_door, **WS, Origin=f"http://{OWN}", Cookie=cookie.split(";")[0]) is None
    assert "Set-Cookie" not in open_door.response_headers("/?token=wrong")


def test_the_token_does_not_let_a_foreign_page_in(open_door):
    assert ask(open_door, "/?token=secret", **WS, Origin="http://evil.example") is not None


def test_the_page_may_ask_nobody_else_and_be_framed_by_nobody(rules):
    headers = rules.response_headers("/")
    assert "default-src 'self'" in headers["Content-Security-Policy"]
    assert "script-src 'none'" in headers["Content-Security-Policy"]
    assert (
        "script-src 'self' 'nonce-abc' 'unsafe-eval';" in rules.response_headers("/", "abc")["Content-Security-Policy"]
    )
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
    if "secret" not in path and "secret" not in cookie:
        assert rules.refusal(path, {"Host": OWN, "Origin": origin, "Cookie": cookie}) is not None


def test_what_changes_something_says_where_it_comes_from(rules):
    assert "POST without Origin" in rules.refusal("/stop", {"Host": OWN}, "POST")
    assert rules.refusal("/stop", {"Host": OWN, "Origin": f"http://{OWN}"}, "POST") is None


def test_another_page_may_lead_here_but_not_use_what_is_here(rules):
    foreign = {"Sec-Fetch-Site": "cross-site"}
    assert ask(rules, **foreign, **{"Sec-Fetch-Mode": "navigate"}) is None
    assert ask(rules, **foreign, **{"Sec-Fetch-Mode": "no-cors"}) is not None
    assert ask(rules, **{"Sec-Fetch-Site": "same-origin", "Sec-Fetch-Mode": "cors"}) is None
