"""Work on a cluster, as far as it needs none: which addresses are taken, and which answers."""

from __future__ import annotations

import hashlib
import pickle
import sys
from concurrent.futures import Future
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import pytest
from click.testing import CliRunner

from consensus.errors import BlockRobotError
from network.bench import cluster
from network.bench.cluster import (
    Answer,
    _ClusterPool,
    check_address,
    check_answer,
    check_seeds,
    cluster_pool,
    describe_code,
)
from network.cli.main import main

if TYPE_CHECKING:
    from distributed import Client

CALL = b"a call"
LIKE = {**describe_code(), "threads": "1"}


@pytest.mark.parametrize(
    "address", ["tls://scheduler.example:8786", "tls://[2001:db8::1]:8786", "tcp://127.0.0.1:8786"]
)
def test_a_scheduler_is_named_by_tls_or_on_this_machine(address: str) -> None:
    assert check_address(address) == address


@pytest.mark.parametrize(
    "address",
    [
        "tcp://scheduler.example:8786",
        "tcp://192.0.2.1:8786",
        "tcp://0.0.0.0:8786",
        "tcp://127.0.0.1.example:8786",
        "tls://scheduler.example",
        "tls://scheduler.example:8786/path",
        "tls://scheduler.example:99999",
        "tls://name@scheduler.example:8786",
        "ws://127.0.0.1:8786",
        "scheduler.example:8786",
    ],
)
@pytest.mark.parametrize(
    "command",
    ["sim run", "bench hiding", "bench matcher", "bench companions", "privacy attack", "experiment run all --out new"],
)
def test_other_addresses_are_refused_before_anything_is_done(command: str, address: str) -> None:
    result = CliRunner().invoke(main, [*command.split(), "--on", address])
    assert result.exit_code == 2
    assert "--on" in result.output


@pytest.mark.parametrize(
    "typed",
    [
        "sim run --workers 2",
        "bench hiding --processes 2",
        "bench matcher --workers 1",
        "privacy attack --processes 1",
    ],
)
def test_a_number_of_processes_beside_a_cluster_is_refused(typed: str) -> None:
    result = CliRunner().invoke(main, [*typed.split(), "--on", "tls://scheduler.example:8786"])
    assert result.exit_code == 2
    assert "how many do it here" in result.output


def test_without_the_extra_it_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(BlockRobotError, match="install-cluster") as refusal,
        cluster_pool("tls://scheduler.example:8786"),
    ):
        pytest.fail("there is a pool")
    assert refusal.value.code == "EXTRA_MISSING"


def test_two_calls_that_are_sent_at_once_have_keys_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second is sent in the middle of the first, as a thread of Dask's may."""
    keys: list[str] = []

    class Dask:
        def get_executor(self) -> Dask:
            return self

        def submit(self, *_call: object, key: str) -> Future[Answer]:
            keys.append(key)
            return Future()

    pool = _ClusterPool(cast("Client", Dask()))

    def describe() -> dict[str, str]:
        if not keys:
            keys.append("the second is on its way")
            pool.submit(len, "second")
        return {}

    monkeypatch.setattr(cluster, "describe_code", describe)
    pool.submit(len, "first")
    assert len(set(keys)) == len(keys) == 3


def test_a_call_of_which_workers_die_is_sent_anew_but_not_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    keys: list[str] = []

    class KilledWorkerError(Exception):
        pass

    class Dask:
        def get_executor(self) -> Dask:
            return self

        def submit(self, *_call: object, key: str) -> Future[Answer]:
            keys.append(key)
            died: Future[Answer] = Future()
            died.set_exception(KilledWorkerError("four workers died"))
            return died

    monkeypatch.setitem(sys.modules, "distributed", SimpleNamespace(KilledWorker=KilledWorkerError))
    outcome = _ClusterPool(cast("Client", Dask())).submit(len, "greedy")
    with pytest.raises(BlockRobotError, match=r"^WORKERS_LOST: 21 times: four workers died"):
        outcome.result(0)
    assert len(keys) == 21


def test_the_answer_of_its_own_call_is_taken() -> None:
    digest = hashlib.blake2b(CALL, digest_size=16).digest()
    assert check_answer(CALL, (digest, LIKE, pickle.dumps((42, None)))) == 42


@pytest.mark.parametrize("name", sorted(LIKE))
def test_the_answer_of_a_worker_that_differs_is_refused(name: str) -> None:
    digest = hashlib.blake2b(CALL, digest_size=16).digest()
    for found in ({**LIKE, name: "other"}, {key: value for key, value in LIKE.items() if key != name}):
        with pytest.raises(BlockRobotError, match=f"has {name} (other|none), not") as refusal:
            check_answer(CALL, (digest, found, b""))
        assert refusal.value.code == "WORKER_UNLIKE"


def test_the_answer_of_another_call_or_seed_is_refused() -> None:
    with pytest.raises(BlockRobotError) as refusal:
        check_answer(CALL, (hashlib.blake2b(b"another", digest_size=16).digest(), LIKE, b""))
    assert refusal.value.code == "CLUSTER_RESULT_FOREIGN"
    check_seeds([1, 2], range(1, 3))
    with pytest.raises(BlockRobotError) as refusal:
        check_seeds([1, 3], range(1, 3))
    assert refusal.value.code == "CLUSTER_RESULT_FOREIGN"


def test_a_refusal_of_a_worker_reaches_whoever_asked() -> None:
    """By default an exception is made anew of its sentence alone."""
    sent = BlockRobotError("EXTRA_MISSING", "The learned attackers need scikit-learn.", extra="attack")
    came = pickle.loads(pickle.dumps(sent))
    assert (came.code, came.detail, came.context, str(came)) == (sent.code, sent.detail, sent.context, str(sent))
    assert came.next_step == sent.next_step
