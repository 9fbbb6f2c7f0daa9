"""R20, R26: whatever proofs a client is given, in whatever order, it ends on the one chain and never goes back."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from consensus.chain.block import EpochProof, FinalityProof
from consensus.chain.light_client import LightClient
from consensus.errors import BlockRobotError
from tests.unit.consensus.many_epochs import GENESIS_FILE, ManyEpochs

steps = st.lists(
    st.one_of(
        st.tuples(st.just("grow"), st.integers(1, 2), st.none()),
        st.tuples(st.just("change"), st.integers(0, 6), st.sampled_from([(), (2, 3), (1, 2), (3, 5, 6)])),
    ),
    min_size=1,
    max_size=6,
)


def proofs_of(plan) -> tuple[list[EpochProof], list[FinalityProof], ManyEpochs]:
    """Make a chain after a plan; return the proofs of its epochs and of its blocks."""
    chain = ManyEpochs()
    epochs, finalities = [], []
    for kind, number, through in plan:
        if kind == "grow":
            finalities += [chain.prove(chain.grow()) for _ in range(number)]
        else:
            epochs.append(chain.change(number, through=through))
    return epochs, finalities, chain


def offered(client: LightClient, offer: EpochProof | FinalityProof) -> str | None:
    """Give the client a proof; return the code of its refusal."""
    try:
        if isinstance(offer, EpochProof):
            client.advance(offer)
        else:
            client.accept(offer)
    except BlockRobotError as error:
        return error.code
    return None


@given(steps)
def test_a_client_that_follows_all_epochs_believes_every_block_of_the_last(plan):
    epochs, _, chain = proofs_of(plan)
    client = LightClient(GENESIS_FILE)
    for proof in epochs:
        client.advance(proof)
    block = chain.grow()
    assert client.accept(chain.prove(block)) == block.header


@given(steps, st.randoms(use_true_random=False))
def test_in_any_order_a_client_only_goes_forward_on_the_one_chain(plan, chance):
    epochs, finalities, chain = proofs_of(plan)
    ids = {block.header_bytes for block in chain.blocks}
    offers = [*epochs, *finalities, *epochs]
    chance.shuffle(offers)
    client = LightClient(GENESIS_FILE)
    for offer in offers:
        before = (client.header.height, client.header.epoch, client.header.round)
        assert offered(client, offer) in {None, "PROOF_STALE", "PROOF_OTHER_EPOCH"}
        after = (client.header.height, client.header.epoch, client.header.round)
        assert after[0] >= before[0]
        assert after[1:] >= before[1:]
        assert client.pinned_header_bytes in ids
        kept = LightClient(GENESIS_FILE, client.pinned_header_bytes, client.epochs)
        assert (kept.header, kept.epoch) == (client.header, client.epoch)
