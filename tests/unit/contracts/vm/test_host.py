"""What a contract sees of the ledger: its own state, the call it is in, events, hashes and signatures."""

from __future__ import annotations

import pytest

from consensus.primitives.encoding import decode_value, encode_value
from consensus.primitives.hashing import sha256, tagged_hash
from consensus.primitives.keys import PrivateKey
from contracts.vm import CallContext, InternalFault, invoke
from network.lab.hostile.places import HOST_STEPS


def test_state_is_kept_and_scanned_under_the_contracts_own_prefix_in_canonical_bytes(run, bench):
    outcome = run("state.put(b'k', {'n': 1})\nstate.put(b'z', None)\nreturn [state.get(b'k'), state.has(b'z')]")
    assert outcome.result == [{"n": 1}, True]
    assert bench.host.entries == {b"it\x00k": encode_value({"n": 1}), b"it\x00z": encode_value(None)}
    bench.host.entries[b"ita\x00p/9"] = encode_value(9)
    body = "for i in [3, 1, 2]:\n    state.put(b'p/' + u32(i), i)\nstate.put(b'q', 0)\nreturn state.scan(b'p/', 2)"
    assert run(body).result == [[b"p/\x00\x00\x00\x01", 1], [b"p/\x00\x00\x00\x02", 2]]
    run("state.put(b'k', {'bb': 1, 'a': 2 ** 200, 1: (1,)})")
    assert decode_value(bench.host.entries[b"it\x00k"]) == {"bb": 1, "a": 2**200, 1: [1]}


def test_a_missing_key_gives_the_default_and_deleting_again_is_no_failure(value, run, bench):
    assert value("[state.get(b'k'), state.get(b'k', 5), state.get(b'k', default=6), state.has(b'k')]") == [
        None, 5, 6, False,
    ]  # fmt: skip
    outcome = run("state.put(b'k', 1)\nstate.delete(b'k')\nstate.delete(b'k')\nreturn state.has(b'k')")
    assert outcome.result is False
    assert bench.host.entries == {}


def test_a_key_and_a_value_have_sizes_and_what_is_read_is_a_copy(run, bench):
    assert run("state.put(a, 1)", b"k" * 128).ok
    assert b"it\x00" + b"k" * 128 in bench.host.entries
    assert run("state.put(b'k', bytes(16000))").ok
    assert run("state.put(b'k', bytes(17000))").code == "VALUE_ERROR"
    assert run("x = []\nfor i in range(20):\n    x = [x]\nstate.put(b'k', x)").code == "VALUE_ERROR"
    assert run("state.put(b'k', range(3))").code == "TYPE_ERROR"
    body = "state.put(b'k', [1])\nx = state.get(b'k')\nx.append(2)\nreturn [x, state.get(b'k')]"
    assert run(body).result == [[1, 2], [1]]


@pytest.mark.parametrize(
    ("key", "expected"), [(b"", "VALUE_ERROR"), (b"k" * 129, "VALUE_ERROR"), ("text", "TYPE_ERROR"), (5, "TYPE_ERROR")]
)
@pytest.mark.parametrize("use", ["state.get(a)", "state.has(a)", "state.put(a, 1)", "state.delete(a)"])
def test_a_key_is_1_to_128_bytes(run, use, key, expected):
    assert run(use, key).code == expected


def test_sharing_does_not_make_a_small_value_a_large_job(run):
    body = "x = [1] * 50\nfor i in range(12):\n    x = [x] * 50\nstate.put(b'k', x)"
    assert run(body).code == "VALUE_ERROR"


def test_the_context_says_who_calls_and_when(value, bench):
    assert value("[ctx.caller, ctx.height, ctx.time, ctx.txid, ctx.chain, ctx.contract, ctx.calling_contract]") == [
        b"\x02" + b"c" * 32, 7, 1_700_000_000_000, b"t" * 32, b"i" * 32, "it", "",
    ]  # fmt: skip


def test_events_reach_the_host_unless_the_call_failed(run, bench):
    outcome = run("emit('done', {'n': 1})")
    assert outcome.events == [("it", "done", encode_value({"n": 1}))]
    assert bench.host.emitted == [("done", encode_value({"n": 1}))]
    assert run("emit('done', {})\nrequire(False, 'NO_WAY')").events == []


@pytest.mark.parametrize(
    ("use", "expected"),
    [
        ("emit('', {})", "VALUE_ERROR"),
        ("emit('ä', {})", "VALUE_ERROR"),
        ("emit(5, {})", "TYPE_ERROR"),
        ("emit('x', [])", "TYPE_ERROR"),
        ("emit('x', {'a': bytes(9000)})", "VALUE_ERROR"),
        ("for i in range(65):\n    emit('x', {})", "EVENT_BUDGET"),
        ("for i in range(257):\n    state.put(b'k', 1)", "WRITE_BUDGET"),
        ("state.scan(b'', 0)", "VALUE_ERROR"),
        ("state.scan(b'', 257)", "VALUE_ERROR"),
        ("sha256('text')", "TYPE_ERROR"),
        ("tagged_hash('ä', b'')", "VALUE_ERROR"),
    ],
)
def test_the_host_refuses(run, use, expected):
    assert run(use).code == expected


def test_hashes_and_recovered_keys_are_those_of_the_protocol(value):
    assert value("[sha256(a), tagged_hash('some/tag', a)]", b"data") == [
        sha256(b"data"),
        tagged_hash("some/tag", b"data"),
    ]
    key = PrivateKey(b"\x01" * 32)
    signature = key.sign("some/tag", b"message")
    assert value("recover('some/tag', a, b)", signature, b"message") == key.public_key
    assert value("recover('some/tag', a, b)", signature, b"another") != key.public_key
    assert value("recover('some/tag', a, b)", b"\x00" * 65, b"message") is None
    assert value("recover('some/tag', a, b)", b"short", b"message") is None


@pytest.mark.parametrize("how", HOST_STEPS["recover"])
def test_recover_costs_the_same_whatever_it_answers(run, how):
    """A signature that leads to the point at infinity makes the library do all the work, and is known by nothing before."""
    step = HOST_STEPS["recover"][how]
    outcome = run(f"return {step}")
    assert (outcome.result is not None) == (how in ("good", "of-another"))
    assert outcome.gas_used >= run("return None").gas_used + 680


class BrokenHost:
    def get(self, key: bytes) -> bytes | None:
        raise OSError("the disk is gone")

    def put(self, key: bytes, value: bytes) -> None:
        raise OSError("the disk is gone")

    delete = scan = emit = put


def test_a_failing_host_or_damaged_state_decides_no_result(bench):
    bench.deploy("it", "@export\ndef f():\n    state.get(b'k')\n")
    with pytest.raises(InternalFault, match="the disk is gone"):
        invoke(
            bench.contracts, "it", "f", [],
            host=BrokenHost(), context=CallContext(b"", 0, 0, b"", b""), gas_limit=1000, mode="export",
        )  # fmt: skip
    bench.deploy("it", "@export\ndef f():\n    state.get(b'k')\n")
    bench.host.entries[b"it\x00k"] = b"\xc1"
    with pytest.raises(InternalFault):
        bench.call("it.f")
