"""Somebody is out of the contract language and runs Python in the worker: what the sandbox still keeps from them."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from consensus.chain.transaction import Transaction
from consensus.primitives.encoding import decode_value
from consensus.primitives.hashing import sha256
from contracts.execution.results import ExecutionFault
from contracts.worker.worker_machine import WorkerSpec, WorkerViews
from tests.worker.conftest import Start
from tests.worker.holed_worker import MARK
from tests.worker.written_blocks import Chain

COMMAND = (sys.executable, "-I", str(Path(__file__).with_name("holed_worker.py")))

Intruder = Callable[[str], str]


@pytest.fixture
async def intrude(chain: Chain, staff: WorkerSpec, lost: list[str]) -> AsyncIterator[Intruder]:
    """Run Python in a worker; return what it says."""
    views = WorkerViews(replace(staff, command=COMMAND))
    snapshot = chain.store.snapshot()

    def run(code: str) -> str:
        data = MARK + code.encode()
        answer: bytes = decode_value(views.run_view(snapshot, snapshot.state_root, 0, 0, "hole", "look", [data]))
        return answer.decode()

    yield run
    snapshot.close()
    views.close()


@pytest.fixture
def victim() -> Iterator[subprocess.Popen[bytes]]:
    """A process of the same user, as the node is one."""
    process = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE, env={"SECRET": "hers"})
    yield process
    process.kill()
    process.communicate()


def test_the_intruder_is_in(intrude: Intruder) -> None:
    assert intrude("6 * 7") == "42"
    assert intrude("sys.version_info[0]") == "3"


def test_no_file_is_read_written_listed_or_removed(intrude: Intruder, tmp_path: Path) -> None:
    key = tmp_path / "producer.key"
    key.write_bytes(b"s" * 32)
    for code in (
        f"open({str(key)!r}, 'rb').read()",
        "open('/etc/passwd').read()",
        f"open({str(tmp_path / 'left')!r}, 'w')",
        f"os.listdir({str(tmp_path)!r})",
        f"os.stat({str(key)!r})",
        f"os.unlink({str(key)!r})",
        f"os.chmod({str(key)!r}, 0o644)",
        f"os.rename({str(key)!r}, {str(key) + '2'!r})",
        "os.memfd_create('mine')",
        "__import__('wave')",
    ):
        assert intrude(code).split(":")[0] in ("PermissionError", "OSError", "ModuleNotFoundError"), code
    assert intrude(f"libc.open({str(key).encode()!r}, 0), ctypes.get_errno()") in ("(-1, 1)", "(-1, 24)")
    assert intrude("libc.syscall(437, -100, b'/etc/passwd', b'\\0' * 24, 24)") == "-1"
    assert key.read_bytes() == b"s" * 32
    assert not (tmp_path / "left").exists()


def test_no_socket_and_no_process_is_made(intrude: Intruder) -> None:
    for code in (
        "socket.socket()",
        "socket.socket(socket.AF_UNIX)",
        "socket.socketpair()",
        "os.pipe()",
        "os.dup(0)",
        "os.fork()",
        "os.execv('/bin/sh', ['sh'])",
        "os.posix_spawn('/bin/true', ['true'], {})",
        "subprocess.run(['/bin/true'])",
    ):
        assert intrude(code).split(":")[0] in ("PermissionError", "OSError", "BlockingIOError"), code
    assert int(intrude("os.system('true')")) >> 8 == 127
    assert intrude("libc.syscall(425, 8, b'\\0' * 120)") == "-1"


def test_no_other_process_is_signalled_traced_or_read(intrude: Intruder, victim: subprocess.Popen[bytes]) -> None:
    pid = victim.pid
    for code in (
        f"os.kill({pid}, 9)",
        f"os.kill({pid}, 0)",
        f"os.killpg({pid}, 9)",
        "signal.pidfd_send_signal(0, 9)",
        f"open('/proc/{pid}/environ').read()",
        f"open('/proc/{os.getpid()}/environ').read()",
        f"open('/proc/{pid}/mem', 'rb')",
    ):
        assert intrude(code).startswith(("PermissionError", "OSError")), code
    assert intrude(f"libc.ptrace(16, {pid}, 0, 0), ctypes.get_errno()") == "(-1, 1)"
    assert intrude(f"libc.process_vm_readv({pid}, 0, 0, 0, 0, 0), ctypes.get_errno()") == "(-1, 1)"
    assert intrude(f"libc.syscall(434, {pid}, 0), ctypes.get_errno()") == "(-1, 1)"
    assert victim.poll() is None


def test_the_environment_is_empty(intrude: Intruder) -> None:
    assert intrude("dict(os.environ)") == "{}"
    assert intrude("[name for name in ('HOME', 'PATH', 'USER') if libc.getenv(name.encode())]") == "[]"


def test_the_ledger_is_not_written(intrude: Intruder, tmp_path: Path) -> None:
    before = (tmp_path / "ledger" / "data.mdb").read_bytes()
    for code in (
        "os.write(3, b'x' * 4096)",
        "os.pwrite(3, b'x' * 4096, 0)",
        "os.ftruncate(3, 0)",
        "mmap.mmap(3, 4096, mmap.MAP_SHARED, mmap.PROT_WRITE)",
        f"open({str(tmp_path / 'ledger' / 'lock.mdb')!r}, 'r+b')",
        f"open({str(tmp_path / 'ledger' / 'data.mdb')!r}, 'r+b')",
    ):
        assert intrude(code).startswith(("PermissionError", "OSError")), code
    assert (tmp_path / "ledger" / "data.mdb").read_bytes() == before


def test_the_sandbox_does_not_open_again(intrude: Intruder) -> None:
    for code in (
        "resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))",
        "os.setuid(0)",
        "os.chroot('/')",
    ):
        assert intrude(code).startswith(("PermissionError", "OSError", "ValueError")), code
    assert intrude("libc.prctl(4, 1, 0, 0, 0), ctypes.get_errno()") == "(-1, 1)"
    assert intrude("libc.unshare(0x10000000), ctypes.get_errno()") == "(-1, 1)"
    assert intrude("mmap.mmap(-1, 4096, prot=mmap.PROT_READ | mmap.PROT_EXEC)").startswith("PermissionError")
    assert intrude("libc.mprotect(id(1) & ~4095, 4096, 7), ctypes.get_errno()") == "(-1, 1)"


def test_memory_ends_where_the_worker_was_told(intrude: Intruder, lost: list[str]) -> None:
    assert intrude("len(bytearray(64 << 20))") == str(64 << 20)
    assert intrude("len(bytearray(1 << 30))") == "MemoryError: "
    assert lost == []


# Blocks, though the interpreter has a hole


def _put(chain: Chain, key: bytes, data: bytes) -> Transaction:
    return chain.hospital.sign(chain.hospital.admin, "hole", "put", key, data)


def _first_time_only(marker: str) -> bytes:
    """Return Python that is harmful in a worker that has answered before, and not in a new one."""
    return (
        MARK + f"({marker}) if sys.modules.setdefault('answered', []) else sys.modules['answered'].append(1)".encode()
    )


async def test_what_ends_every_worker_is_left_out_by_a_leader_and_gets_no_vote(
    chain: Chain, start: Start, lost: list[str]
) -> None:
    machine = start(command=COMMAND)
    deadly = _put(chain, b"deadly", MARK + b"os._exit(7)")
    sound = [_put(chain, b"a", b"1"), _put(chain, b"b", b"2")]
    result, faulty = machine.build(chain.view, 1, chain.time_ms(1), [sound[0], deadly, sound[1]])
    assert faulty == [deadly.txid]
    assert list(result.left_out) == [deadly.txid, sound[1].txid]
    assert [receipt.txid for receipt in result.receipts] == [sound[0].txid]
    result, faulty = machine.build(chain.view, 1, chain.time_ms(1), sound)
    assert faulty == []
    assert {decode_value(value) for value in result.writes.values() if value} == {sha256(b"1"), sha256(b"2")}
    assert set(lost) == {"it ended with code 7"}
    with pytest.raises(ExecutionFault, match="ended with code 7") as caught:
        machine.verify(chain.view, 1, chain.time_ms(1), [sound[0], deadly])
    assert (caught.value.txid, caught.value.in_change) == (deadly.txid, False)
    assert machine.verify(chain.view, 1, chain.time_ms(1), sound).receipts == result.receipts


@pytest.mark.parametrize(
    ("harm", "reason"),
    [
        ("os._exit(7)", "it ended with code 7"),
        ("ctypes.string_at(0)", "it ended by signal 11"),
        (r"os.write(1, b'\0\0\0\1\xc1')", "it spoke nonsense"),
    ],
)
async def test_a_worker_that_fails_once_is_replaced_and_the_block_comes_out_the_same(
    chain: Chain, start: Start, lost: list[str], harm: str, reason: str
) -> None:
    """The first block leaves a mark in the worker, by which the second one harms it; the next worker has no mark."""
    machine = start(command=COMMAND)
    spoil = _put(chain, b"x", _first_time_only(harm))
    first = machine.verify(chain.view, 1, chain.time_ms(1), [spoil])
    assert lost == []
    assert machine.verify(chain.view, 1, chain.time_ms(1), [spoil]) == first
    assert len(lost) == 1
    assert lost[0].startswith(reason)


async def test_the_interpreters_own_failure_is_believed_only_from_a_new_worker(
    chain: Chain, start: Start, lost: list[str]
) -> None:
    machine = start(command=COMMAND)
    sound = _put(chain, b"a", b"1")
    expected = machine.verify(chain.view, 1, chain.time_ms(1), [sound])
    spoil = _put(chain, b"x", MARK + b"exec('import contracts.vm.builtins.host as host; host.hashing = None')")
    for once_more in (1, 2):
        machine.verify(chain.view, 1, chain.time_ms(1), [spoil])
        assert machine.build(chain.view, 1, chain.time_ms(1), [sound]) == (expected, [])
        assert len(lost) == once_more
    machine.verify(chain.view, 1, chain.time_ms(1), [spoil])
    assert machine.verify(chain.view, 1, chain.time_ms(1), [sound]) == expected
    assert len(lost) == 3
