import asyncio

import pytest

from canopen_control.view.page_address import AccessRules
from canopen_control.view.page_server import AccessMiddleware

HOST = (b"host", b"127.0.0.1:8080")
OWN = (b"origin", b"http://127.0.0.1:8080")
HTML = [(b"content-type", b"text/html; charset=utf-8"), (b"content-length", b"1")]


def ask(headers, kind="http", path="/secret/", answer=(HTML, b"<script>1</script>"), method="GET"):
    """Send a request through the guard; returns whether it came through, and what was answered."""
    came, sent = [], []

    async def app(scope, _receive, send):
        came.append(scope)
        await send({"type": "http.response.start", "status": 200, "headers": answer[0]})
        half = len(answer[1]) // 2
        await send({"type": "http.response.body", "body": answer[1][:half], "more_body": True})
        await send({"type": "http.response.body", "body": answer[1][half:]})

    async def receive():
        return {"type": f"{kind}.connect"}

    async def send(message):
        sent.append(message)

    scope = {"type": kind, "path": path, "query_string": b"", "headers": headers, "method": method}
    asyncio.run(AccessMiddleware(app, AccessRules("127.0.0.1", 8080, "secret"))(scope, receive, send))
    return came, sent


def test_an_unauthorised_client_reaches_nothing():
    came, sent = ask([(b"host", b"evil")])
    assert (came, sent[0]["status"]) == ([], 403)
    assert b"evil" in sent[1]["body"]


def test_without_the_token_nothing_is_reached_and_the_refusal_leads_nowhere():
    came, (start, body) = ask([HOST], path="/")
    headers = dict(start["headers"])
    assert (came, start["status"], headers[b"referrer-policy"]) == ([], 403, b"no-referrer")
    assert b"secret" not in body["body"] + b"".join(value for _, value in start["headers"])
    assert ask([HOST, OWN, (b"upgrade", b"websocket")], "websocket", path="/_nicegui_ws/")[0] == []


def test_the_address_without_its_last_slash_leads_to_the_page():
    came, (start, _) = ask([HOST], path="/secret")
    assert (came, start["status"], dict(start["headers"])[b"location"]) == ([], 307, b"/secret/")


def test_a_websocket_is_closed_before_it_is_open():
    came, sent = ask([HOST, (b"upgrade", b"websocket")], "websocket")
    assert (came, [message["type"] for message in sent]) == ([], ["websocket.close"])
    assert ask([HOST, OWN, (b"upgrade", b"websocket")], "websocket")[0]


@pytest.mark.parametrize("twice", [HOST, OWN])
def test_a_header_that_comes_twice_fits_nothing(twice):
    other = (twice[0], b"evil")
    for order in ([twice, other], [other, twice]):
        assert ask([HOST, *order] if twice is OWN else order)[0] == []


def test_html_comes_whole_with_its_nonce_and_its_length():
    _, (start, body) = ask([HOST])
    headers = dict(start["headers"])
    nonce = headers[b"content-security-policy"].split(b"'nonce-")[1].split(b"'")[0]
    assert body["body"] == b'<script nonce="%s">1</script>' % nonce
    assert headers[b"content-length"] == str(len(body["body"])).encode()
    assert headers[b"cache-control"] == b"no-store"


def test_anything_else_goes_through_as_it_comes():
    _, sent = ask(
        [HOST], answer=([(b"content-type", b"text/javascript"), (b"cache-control", b"max-age=9")], b"<script>")
    )
    assert b"".join(message.get("body", b"") for message in sent) == b"<script>"
    headers = dict(sent[0]["headers"])
    assert headers[b"cache-control"] == b"max-age=9"
    assert b"script-src 'none'" in headers[b"content-security-policy"]


def test_a_proxys_word_goes_no_further():
    came, _ = ask([HOST, (b"x-forwarded-prefix", b"/x"), (b"accept", b"*/*")])
    assert came[0]["headers"] == [HOST, (b"accept", b"*/*")]


def test_the_begin_and_the_end_of_the_server_are_not_request():
    observed = []

    async def app(scope, _receive, _send):
        observed.append(scope["type"])

    asyncio.run(AccessMiddleware(app, AccessRules("127.0.0.1", 8080, "secret"))({"type": "lifespan"}, None, None))
    assert observed == ["lifespan"]
