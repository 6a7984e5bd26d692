import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.view.door import Door, is_loopback

OWN = "127.0.0.1:8080"
WS = {"Upgrade": "websocket"}


def ask(door, path="/", **headers):
    return door.refusal(path, {"Host": OWN, **headers})


@pytest.fixture
def door():
    return Door("127.0.0.1", 8080)


@pytest.fixture
def open_door():
    return Door("0.0.0.0", 8080, "secret")


def test_the_page_and_its_own_socket_come_in(door):
    assert ask(door) is None
    assert ask(door, **WS, Origin=f"http://{OWN}") is None
    assert ask(door, **WS, Host="localhost:8080", Origin="http://localhost:8080") is None


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
def test_whoever_else_asks_is_refused(door, headers):
    assert ask(door, **headers) is not None
    assert ask(door, **(WS | headers)) is not None


def test_loopback_needs_no_token_and_everything_else_has_one():
    assert Door("127.0.0.1", 1).token is None
    assert Door("127.0.0.1", 1).url == "http://127.0.0.1:1/"
    first, second = Door("0.0.0.0", 1), Door("192.168.1.5", 1)
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


def test_the_page_may_ask_nobody_else_and_be_framed_by_nobody(door):
    headers = door.response_headers("/")
    assert "default-src 'self'" in headers["Content-Security-Policy"]
    assert "script-src 'none'" in headers["Content-Security-Policy"]
    assert (
        "script-src 'self' 'nonce-abc' 'unsafe-eval';" in door.response_headers("/", "abc")["Content-Security-Policy"]
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
    door = Door("0.0.0.0", 8080, "secret")
    if "secret" not in path and "secret" not in cookie:
        assert door.refusal(path, {"Host": OWN, "Origin": origin, "Cookie": cookie}) is not None


def test_what_changes_something_says_where_it_comes_from(door):
    assert "POST without Origin" in door.refusal("/stop", {"Host": OWN}, "POST")
    assert door.refusal("/stop", {"Host": OWN, "Origin": f"http://{OWN}"}, "POST") is None


def test_another_page_may_lead_here_but_not_use_what_is_here(door):
    foreign = {"Sec-Fetch-Site": "cross-site"}
    assert ask(door, **foreign, **{"Sec-Fetch-Mode": "navigate"}) is None
    assert ask(door, **foreign, **{"Sec-Fetch-Mode": "no-cors"}) is not None
    assert ask(door, **{"Sec-Fetch-Site": "same-origin", "Sec-Fetch-Mode": "cors"}) is None
