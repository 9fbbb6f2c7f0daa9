"""A Dask cluster as an executor: for pure functions of seeds and drawn scenes, on workers that run the same code."""

from __future__ import annotations

import hashlib
import ipaddress
import logging
import pickle  # of our own calls, and of answers of workers that a certificate admits
import platform
import ssl
import traceback
import uuid
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future
from contextlib import contextmanager, suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar
from urllib.parse import urlsplit

from consensus.errors import BlockRobotError

if TYPE_CHECKING:
    from distributed import Client, Security, Worker

T = TypeVar("T")
Answer = tuple[bytes, dict[str, str], bytes]

_CONNECT_MAX_S = 10.0
_FIRST_WORKER_MAX_S = 30.0
_RESTART_MAX_S = 30.0
_RESENT_MAX_COUNT = 20  # each time, Dask has seen four workers die of it
_DIGEST_BYTES = 16
_QUOTED_MAX_CHARS = 2_000
_PACKAGES = ("consensus", "contracts", "node", "clients", "network", "pages")
_SOURCES = frozenset({".py", ".json", ".toml"})
_LIBRARIES = ("msgspec", "numpy", "opencv-python-headless", "scikit-learn", "scipy")


def check_address(address: str) -> str:
    """Raises ValueError."""
    url = urlsplit(address)
    if url.scheme not in {"tls", "tcp"} or not url.hostname or not url.port or url.path or url.username:
        raise ValueError("a scheduler is tls://HOST:PORT, or tcp://127.0.0.1:PORT on this machine")
    if url.scheme == "tcp" and not _is_loopback(address):
        raise ValueError("tcp:// is not encrypted and for this machine alone (127.0.0.1, ::1): use tls://")
    return address


@contextmanager
def cluster_pool(address: str) -> Iterator[Executor]:
    """On early exit nothing runs on. Raises EXTRA_MISSING, CLUSTER_CERTIFICATES, CLUSTER_UNREACHABLE, WORKER_UNLIKE."""
    with _connect(address) as client:
        _refuse_unlike(client)
        pool = _ClusterPool(client)
        try:
            yield pool
        except BaseException as error:
            pool.end()
            if isinstance(error, Exception) and client.status == "running":
                _refuse_unlike(client)  # a worker that came later may be why
            raise


class _ClusterPool(Executor):
    """Sends calls, pickled by reference, and holds each answer against its call."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._dask = client.get_executor()
        self._name = f"blockrobot-{uuid.uuid4().hex}"
        self._count = count()  # calls are sent from Dask's threads too

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        call = pickle.dumps((fn, args, kwargs))
        outcome: Future[T] = Future()
        self._send(call, outcome, lost=0)
        return outcome

    def _send(self, call: bytes, outcome: Future[T], lost: int) -> None:
        sent = self._dask.submit(do_call, call, describe_code(), key=f"{self._name}-{next(self._count)}")
        sent.add_done_callback(lambda answered: self._take(answered, call, outcome, lost))

    def _take(self, answered: Future[Answer], call: bytes, outcome: Future[T], lost: int) -> None:
        """A call whose worker dies again and again is given up by Dask, and sent once more here."""
        from distributed import KilledWorker  # noqa: PLC0415 - only with a cluster

        if outcome.cancelled():
            return
        try:
            outcome.set_result(check_answer(call, answered.result()))
        except KilledWorker as error:
            if lost < _RESENT_MAX_COUNT:
                self._send(call, outcome, lost + 1)
            else:
                outcome.set_exception(BlockRobotError("WORKERS_LOST", f"{_RESENT_MAX_COUNT + 1} times: {error}"))
        except BaseException as error:  # noqa: BLE001 - CancelledError too: given to whoever waits for the result
            outcome.set_exception(error if isinstance(error, Exception) else BlockRobotError("CLUSTER_UNREACHABLE"))

    def end(self) -> None:
        """Drop what waits, and restart the workers that are at it."""
        with suppress(Exception):  # nothing to end on a cluster that is gone
            at_it = [
                worker
                for worker, keys in self._client.processing().items()
                if any(str(key).startswith(self._name) for key in keys)
            ]
            self._dask.shutdown(wait=False)
            self._client.restart_workers(at_it, timeout=_RESTART_MAX_S, raise_for_error=False)


def do_call(call: bytes, wanted: dict[str, str]) -> Answer:
    """On a worker: the call's digest, who did it, and its result, if the worker is like the client."""
    import cv2  # noqa: PLC0415 - only a worker's

    cv2.setNumThreads(1)
    here = describe_worker()
    if here != {**wanted, "threads": "1"}:
        return _digest(call), here, b""
    return _digest(call), here, _outcome_of(call)


def _outcome_of(call: bytes) -> bytes:
    """Result or error: Dask's client waits for ever for an error whose traceback cannot be unpickled."""
    try:
        function, args, kwargs = pickle.loads(call)  # noqa: S301 - whoever may send it may run what they like
        return pickle.dumps((function(*args, **kwargs), None))
    except Exception as error:  # noqa: BLE001 - raised where the result is awaited
        text = "".join(traceback.format_exception(error))[-_QUOTED_MAX_CHARS:]
        error.add_note(f"On a worker: {text}")
        with suppress(Exception):
            outcome = pickle.dumps((None, error.with_traceback(None)))  # Dask lets pickle take tracebacks too
            pickle.loads(outcome)  # noqa: S301 - our own
            return outcome
        return pickle.dumps((None, RuntimeError(text)))


def check_answer(call: bytes, answer: Answer) -> Any:
    """Raises CLUSTER_RESULT_FOREIGN, WORKER_UNLIKE, and what the call raised."""
    digest, worker, outcome = answer
    if digest != _digest(call):
        raise BlockRobotError("CLUSTER_RESULT_FOREIGN")
    _refuse_difference("A worker", worker)
    result, error = pickle.loads(outcome)  # noqa: S301 - of a worker that a certificate admits
    if error is not None:
        raise error
    return result


def check_seeds(found: Sequence[object], asked: Sequence[object]) -> None:
    """Results say which seed they are of. Raises CLUSTER_RESULT_FOREIGN."""
    if [*found] != [*asked]:
        raise BlockRobotError("CLUSTER_RESULT_FOREIGN")


def describe_worker(dask_worker: Worker | None = None) -> dict[str, str]:
    """Dask gives the worker itself by that name to what it runs outside of tasks."""
    from distributed import get_worker  # noqa: PLC0415 - only a worker's

    return {**describe_code(), "threads": str((dask_worker or get_worker()).state.nthreads)}


@cache
def describe_code() -> dict[str, str]:
    """What results depend on, beside the seed."""
    source = hashlib.blake2b(digest_size=_DIGEST_BYTES)
    root = Path(__file__).resolve().parents[2]
    for path in sorted(path for package in _PACKAGES for path in (root / package).rglob("*")):
        if path.suffix in _SOURCES:
            content = path.read_bytes()
            source.update(f"{path.relative_to(root).as_posix()} {len(content)}\n".encode() + content)
    return {
        "blockrobot": version("blockrobot"),
        "python": platform.python_version(),
        "source": source.hexdigest(),
        **{name: _version_of(name) for name in _LIBRARIES},
    }


def _connect(address: str) -> Client:
    try:
        from distributed import Client, Security  # noqa: PLC0415 - only with a cluster
    except ImportError:
        text = "Work on a cluster needs Dask's distributed: `make install-cluster` in your clone."
        raise BlockRobotError("EXTRA_MISSING", text, extra="cluster") from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what goes wrong is said once, by us
    secure = address.startswith("tls:")
    security = Security(require_encryption=True, tls_min_version=ssl.TLSVersion.TLSv1_3) if secure else None
    if security is not None:
        _check_certificates(security)
    try:
        client = Client(address, security=security, timeout=_CONNECT_MAX_S, set_as_default=False)
    except OSError:
        raise BlockRobotError(
            "CLUSTER_UNREACHABLE", f"{address} does not answer, or refuses the certificate."
        ) from None
    try:
        client.wait_for_workers(1, timeout=_FIRST_WORKER_MAX_S)
    except TimeoutError:
        client.close()
        raise BlockRobotError("CLUSTER_UNREACHABLE", f"The scheduler {address} has no worker.") from None
    return client


def _check_certificates(security: Security) -> None:
    """Raises CLUSTER_CERTIFICATES."""
    if not (security.tls_ca_file and security.tls_client_cert):
        raise BlockRobotError(
            "CLUSTER_CERTIFICATES", "Dask's configuration names no CA, or no certificate of the client."
        )
    try:
        security.get_connection_args("client")
    except (OSError, ssl.SSLError) as error:
        text = f"A file that Dask's configuration names cannot be used: {error.strerror or 'no PEM'}."
        raise BlockRobotError("CLUSTER_CERTIFICATES", text) from None


def _refuse_unlike(client: Client) -> None:
    """Raises WORKER_UNLIKE."""
    for address, found in client.run(describe_worker, on_error="return").items():
        if isinstance(found, Exception):
            raise BlockRobotError(
                "WORKER_UNLIKE", f"Worker {address} has no such BlockRobot: {repr(found)[:_QUOTED_MAX_CHARS]}."
            )
        _refuse_difference(f"Worker {address}", found)
        if address.startswith("tcp:") and not _is_loopback(address):
            raise BlockRobotError("WORKER_UNLIKE", f"Worker {address} is of another machine, and not encrypted.")


def _refuse_difference(who: str, found: dict[str, str]) -> None:
    """Raises WORKER_UNLIKE."""
    for name, wanted in {**describe_code(), "threads": "1"}.items():
        if (has := found.get(name, "none")) != wanted:
            raise BlockRobotError("WORKER_UNLIKE", f"{who} has {name} {has}, not {wanted}.")


def _is_loopback(address: str) -> bool:
    host = urlsplit(address).hostname or ""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _version_of(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:
        return "none"


def _digest(call: bytes) -> bytes:
    return hashlib.blake2b(call, digest_size=_DIGEST_BYTES).digest()
