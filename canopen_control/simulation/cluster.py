"""Campaign on an existing Dask cluster; the seeds of a lost worker are repeated.

Workers need the same version of this package, with `distributed`, and the robot's files at the same paths. A worker
runs one seed at a time regardless of its number of threads, so that one worker process per processor is best.
"""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import logging
import re
import threading
from typing import TYPE_CHECKING, Any, Final

from canopen_control.errors import CanopenError, ConfigError
from canopen_control.version import __version__

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from distributed import Client, Future

    from canopen_control.simulation.campaign import Campaign, SeedResult


_CONNECT_S: Final = 3.0
_ADDRESS: Final = re.compile(r"((tcp|tls|ws|wss|ucx)://)?(\[[0-9a-fA-F:.%]+\]|[^\s/:\[\]]+):[0-9]{1,5}")
_ONE_AT_A_TIME: Final = threading.Lock()  # simulated buses are found by name within a process


def require_cluster() -> None:
    """Raise ConfigError, with the installation command, if `distributed` is missing; the check does not import it."""
    if importlib.util.find_spec("distributed") is None:
        raise ConfigError("seeds on a Dask cluster need distributed: pip install 'canopen-control[cluster]'")


def run_on_cluster(
    campaign: Campaign, seeds: Sequence[int], address: str, note: Callable[[str], object] = lambda _text: None
) -> Iterator[SeedResult]:
    """Yield seed results in order of completion; raise ConfigError without a cluster, CanopenError if it is lost.

    `note` receives a sentence if the cluster has no worker yet. A seed whose workers died repeatedly runs in this
    process.
    """
    require_cluster()
    with _connected(address) as client:
        if not client.scheduler_info()["workers"]:
            note(f"the cluster at {address} has no worker yet; waiting for one (start it with: dask worker {address})")
        yield from _results(client, campaign, seeds, address)


@contextlib.contextmanager
def _connected(address: str) -> Iterator[Client]:
    from distributed import Client

    if not _ADDRESS.fullmatch(address):
        raise ConfigError(f"--dask {address!r} is not an address of a Dask cluster, such as tcp://host:8786")
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # relevant messages are reported as sentences
    try:
        client = Client(address, timeout=_CONNECT_S, set_as_default=False)
    except OSError as error:
        raise ConfigError(f"--dask {address}: no Dask cluster answers at this address: {error}") from None
    try:
        yield client
    finally:
        client.close(timeout=_CONNECT_S)


def _results(client: Client, campaign: Campaign, seeds: Sequence[int], address: str) -> Iterator[SeedResult]:
    from cloudpickle import dumps
    from distributed import KilledWorker, as_completed

    # a task, because the campaign must survive the worker that stores it
    packed = client.submit(_same, dumps(campaign), pure=False)
    futures = {client.submit(_run_seed, packed, seed, __version__, pure=False): seed for seed in seeds}
    for future in as_completed(futures, loop=client.loop):
        error = future.exception() if future.status == "error" else None
        if future.status == "finished":
            yield future.result()
            future.release()
        elif isinstance(error, KilledWorker):
            yield campaign.run_seed(futures[future])
        else:
            raise CanopenError(_why(future, error, address))


def _why(future: Future, error: BaseException | None, address: str) -> str:
    if isinstance(error, CanopenError):
        return str(error)
    if isinstance(error, ImportError):
        return f"the workers at {address} cannot run a simulation: {error}; install canopen-control[cluster] there"
    if error is not None:
        return f"the cluster at {address} could not run a seed: {type(error).__name__}: {error}"
    return f"the cluster at {address} was lost: its scheduler returned a seed as {future.status}"


# -- on a worker


def _same(packed: bytes) -> bytes:
    return packed


def _run_seed(packed: bytes, seed: int, version: str) -> SeedResult:
    """Run a seed on a worker; raise ConfigError if the worker has another version of this package."""
    if version != __version__:
        raise ConfigError(
            f"a worker has canopen-control {__version__}, and this computer has {version}; install the same on both"
        )
    with _ONE_AT_A_TIME:
        campaign: Campaign = _unpacked(packed)
        return campaign.run_seed(seed)


@functools.lru_cache(maxsize=4)
def _unpacked(packed: bytes) -> Any:  # noqa: ANN401 - a campaign, of which this process has one
    from cloudpickle import loads

    return loads(packed)
