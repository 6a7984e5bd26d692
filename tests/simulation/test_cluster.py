import os
import signal

import pytest
from support.simulated import S, setup_of

from canopen_control.errors import CanopenError, ConfigError
from canopen_control.simulation import cluster
from canopen_control.simulation.campaign import Campaign
from canopen_control.simulation.cluster import run_on_cluster
from canopen_control.simulation.random_schedule import known_faults

SEEDS = range(8)


@pytest.fixture(scope="module")
def campaign():
    return Campaign(setup_of(), 2 * S, known_faults())


@pytest.fixture(scope="module")
def workers():
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as created:
        yield created


@pytest.mark.process
def test_a_worker_that_is_killed_costs_its_seeds_a_retry_and_changes_no_result(campaign, workers):
    pids = [worker.pid for worker in workers.workers.values()]
    match = {}
    for result in run_on_cluster(campaign, SEEDS, workers.scheduler_address):
        if not match:
            os.kill(pids[0], signal.SIGKILL)
        match[result.seed] = result
    here = {result.seed: result for result in campaign.run(SEEDS, 1)}
    assert sorted(match) == list(SEEDS)
    assert [match[seed].sha256 for seed in SEEDS] == [here[seed].sha256 for seed in SEEDS]
    assert [match[seed].troubles for seed in SEEDS] == [here[seed].troubles for seed in SEEDS]


class Made:
    """A task that was given back, or what it raises."""

    def __init__(self, status="finished", error=None, value=None):
        self.status, self.error, self.value = status, error, value

    def exception(self):
        return self.error

    def result(self):
        return self.value

    def release(self):
        pass


class Scheduler:
    """A client of a cluster whose tasks end as configured."""

    loop = None

    def __init__(self, make):
        self.make, self.asked = make, 0

    def submit(self, work, *words, pure):
        if work is cluster._same:
            return words[0]
        self.asked += 1
        return self.make(work, words)


def results(campaign, make, monkeypatch):
    monkeypatch.setattr("distributed.as_completed", lambda futures, loop: list(futures))
    return list(cluster._results(Scheduler(make), campaign, [3, 4], "tcp://there:1"))


def test_what_a_worker_gets_runs_the_same_seed(campaign, monkeypatch):
    result = results(campaign, lambda work, words: Made(value=work(*words)), monkeypatch)
    assert [item.seed for item in result] == [3, 4]
    assert result[0].sha256 == campaign.run_seed(3).sha256


def test_a_robot_whose_parameters_depend_on_its_joints_is_a_message_too(monkeypatch):
    arm = Campaign(setup_of("arm6"), S, [])
    result = results(arm, lambda work, words: Made(value=work(*words)), monkeypatch)
    assert result[1].sha256 == arm.run_seed(4).sha256


def test_a_seed_whose_workers_die_again_and_again_runs_here(campaign, monkeypatch):
    from distributed import KilledWorker

    killed = KilledWorker("seed", None, 3)
    result = results(campaign, lambda _work, _words: Made("error", killed), monkeypatch)
    assert [item.seed for item in result] == [3, 4]


@pytest.mark.parametrize(
    ("created", "text"),
    [
        (Made("error", ModuleNotFoundError("No module named 'canopen_control'")), "install canopen-control"),
        (Made("error", ConfigError("arm.eds: not there")), "^arm.eds: not there$"),
        (Made("error", ValueError("odd")), "could not run a seed: ValueError: odd"),
        (Made("cancelled"), "tcp://there:1 was lost"),
    ],
)
def test_what_ends_a_campaign_is_a_sentence(campaign, monkeypatch, created, text):
    with pytest.raises(CanopenError, match=text):
        results(campaign, lambda _work, _words: created, monkeypatch)


def test_a_worker_of_another_version_is_reported(campaign):
    with pytest.raises(ConfigError, match=r"this computer has 0\.0\.1; install the same"):
        cluster._run_seed(b"", 1, "0.0.1")


@pytest.mark.parametrize("address", ["localhost", "foo://x:1", "", "tcp://:8786", "tcp://host:port"])
def test_what_is_not_an_address_is_reported(campaign, address):
    with pytest.raises(ConfigError, match="is not an address of a Dask cluster"):
        list(run_on_cluster(campaign, SEEDS, address))


def test_no_cluster_at_an_address_is_reported_soon(campaign, monkeypatch):
    monkeypatch.setattr(cluster, "_CONNECT_S", 0.2)
    with pytest.raises(ConfigError, match=r"tcp://127\.0\.0\.1:9: no Dask cluster answers at this address"):
        list(run_on_cluster(campaign, SEEDS, "tcp://127.0.0.1:9"))


def test_without_the_extra_it_suggests_what_to_install(campaign, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda _name: None)
    with pytest.raises(ConfigError, match=r"pip install 'canopen-control\[cluster\]'"):
        list(run_on_cluster(campaign, SEEDS, "tcp://127.0.0.1:9"))
