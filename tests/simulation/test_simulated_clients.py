import pytest
from support.simulated import FORWARD, Played


def test_a_querying_client_is_answered_and_leaves(played: Played):
    played.do("ask", seconds=0.45).run(0.35)
    [client] = played.player.clients.all
    assert (client.answers, client.waits_since) == (4, None)
    played.run(0.5)
    assert client.answers == 5
    assert client.dropped


def test_silent_clients_are_closed_for_active_ones(played: Played):
    played.do("silent", values=(80.0,)).run(0.1).do("ask").run(1.0)
    clients = played.player.clients.all
    assert sum(client.dropped for client in clients) >= 80 - 71
    assert clients[-1].answers >= 3
    assert not clients[-1].dropped


def test_a_client_that_never_reads_is_dropped_with_a_message_and_blocks_no_other(played: Played):
    cycles = played.robot.core.pacer.count
    played.do("deaf").run(4.0)
    [client] = played.player.clients.all
    assert client.dropped
    assert "client_dropped" in played.kinds
    assert played.robot.core.pacer.count - cycles == pytest.approx(200, abs=1)


def test_a_command_ends_with_its_client(played: Played):
    played.do("dead_man", FORWARD, 0.3, values=(5.0, 5.0)).run(0.25)
    assert played.speed(2) > 1000.0
    played.run(0.4)
    assert played.speed(2) == 0.0
    assert "commander_gone" in played.kinds


def test_clients_of_a_process_that_was_killed_are_gone(played: Played):
    played.do("ask").run(0.3)
    first = played.player.clients.all
    played.do("kill", seconds=0.2).run(0.1).do("ask").run(1.5)
    assert played.player.clients.all == first
    played.do("ask").run(0.3)
    [second] = played.player.clients.all
    assert second not in first
    assert second.answers == 3
    assert first[0].answers == 3


@pytest.mark.rest
def test_two_simulations_of_clients_are_the_same():
    digests = []
    for _ in range(2):
        played = Played(seed=4)
        played.do("deaf").do("silent", seconds=0.5, values=(80.0,)).do("dead_man", FORWARD, 0.2, values=(5.0, 1.0)).run(
            4.0
        )
        digests.append(played.robot.digest.hex)
        played.close()
    assert digests[0] == digests[1]
