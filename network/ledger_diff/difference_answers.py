"""What `blockrobot node diff` answers with `--json`."""

from __future__ import annotations

from typing import Annotated

from msgspec import UNSET, UnsetType

from clients.sdk.terminal.json_answers import Answer, Count, Height, Hex, doc


class ComparedHeader(Answer, frozen=True, kw_only=True):
    """A node's header of the first block that differs."""

    block_id: Annotated[Hex, doc("The block")]
    parent_id: Annotated[Hex, doc("The block before it")]
    epoch: Annotated[Count, doc("Its epoch")]
    round: Annotated[Count, doc("Its round")]
    producer: Annotated[Count, doc("Its producer's turn in the epoch")]
    state_root: Annotated[Hex, doc("The root of the state")]
    transactions_root: Annotated[Hex, doc("The root of its transactions")]


class KeyWriter(Answer, frozen=True, kw_only=True):
    """What wrote a key of the state last."""

    height: Annotated[Height, doc("In which block")]
    block_id: Annotated[Hex, doc("That block")]
    txid: Annotated[Hex | None, doc("The transaction; null if it was the block itself")]
    call: Annotated[str | None, doc("The contract and entry that it called; null if it was the block itself")]
    sender: Annotated[Hex | None, doc("Who sent it; null if it was the block itself")]


class DifferingKey(Answer, frozen=True, kw_only=True):
    """A key of the state on which the nodes differ. `A` is the first node, `B` the second."""

    contract: Annotated[str, doc("Whose state it is")]
    key: Annotated[str, doc("The key, as text where it is text")]
    flat_key: Annotated[Hex, doc("The whole key")]
    values: Annotated[dict[str, str | None], doc("The value at `A` and `B`; null where there is none")]
    right: Annotated[str | None, doc("`A` or `B`, as the header proves; null if it does not tell")]
    written_by: Annotated[dict[str, KeyWriter | None], doc("What wrote it at `A` and `B`; null if that is not known")]


class NodeDiffAnswer(Answer, frozen=True, kw_only=True):
    """How two nodes differ. `ok` is false if they do. `A` is the first node, `B` the second."""

    same: Annotated[bool, doc("Whether nothing differs, and all was compared")]
    kind: Annotated[str, doc("What differs: `none`, `header`, `body`, `receipts` or `state`")]
    nodes: Annotated[dict[str, str], doc("The name of `A` and `B`")]
    heights: Annotated[dict[str, Height], doc("The newest block of `A` and `B`")]
    earliest_heights: Annotated[dict[str, Height], doc("The oldest block whose body `A` and `B` have")]
    headers_compared_from: Annotated[Height, doc("The first block whose header was compared")]
    bodies_compared_from: Annotated[Height, doc("The first block whose body was compared")]
    notes: Annotated[list[str], doc("What could not be compared or found out")]
    first_block: Annotated[Height | UnsetType, doc("The first block that differs; absent if nothing differs")] = UNSET
    first_block_is_at_most: Annotated[
        bool | UnsetType, doc("Whether an earlier one may differ; absent if nothing differs")
    ] = UNSET
    headers: Annotated[
        dict[str, ComparedHeader | None] | UnsetType, doc("Its header at `A` and `B`; absent if nothing differs")
    ] = UNSET
    keys: Annotated[list[DifferingKey] | UnsetType, doc("Keys of the state that differ; absent if nothing differs")] = (
        UNSET
    )
    keys_are_all: Annotated[bool | UnsetType, doc("Whether no other key differs; absent if nothing differs")] = UNSET
    damaged_pages: Annotated[
        list[str] | UnsetType, doc("Pages of the state's trie that are damaged; absent if nothing differs")
    ] = UNSET
    right: Annotated[
        str | UnsetType | None,
        doc("Who has what the header names, `A` or `B`; null if none or both; absent unless bodies or receipts differ"),
    ] = UNSET
