"""Who may have a transaction wait: a pure function of the finalized state. Must never decide what a contract decides.

Standing keeps strangers from filling the pool. A sender has it as an active member, as the owner of a finalized visit
(for its consent, access and erasure only), as a custodian, as a registrar or admin, or by a registration whose
voucher and card signature are good and whose handle is free.
"""

from __future__ import annotations

from typing import Any

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value, u64
from consensus.primitives.keys import recover
from consensus.records.vouchers import CARD_TAG, VOUCHER_TAG
from consensus.transaction import Transaction
from contracts.state.view import StateReader

OWNER_CONTRACTS = frozenset({"access", "erasure"})
ORGANISATIONS_MAX_COUNT = 256
_REGISTER_ARGUMENTS_COUNT = 10


def _is_active_member(state: StateReader, sender: bytes) -> bool:
    data = state.get(b"identity\x00member/" + sender)
    return data is not None and decode_value(data)["status"] == "active"


def _is_admin(state: StateReader, sender: bytes) -> bool:
    organisations = state.scan(b"identity\x00org/", ORGANISATIONS_MAX_COUNT)
    return any(sender in decode_value(value)["admins"] for _, value in organisations)


def _recovers(tag: str, signature: Any, message: bytes) -> bytes | None:
    try:
        return recover(tag, signature, message)
    except BlockRobotError:
        return None


def _holds_voucher(state: StateReader, transaction: Transaction, chain_time_ms: int) -> bool:
    """Tell whether a registration would pass for its signatures, its expiry and its handle."""
    arguments = transaction.arguments()
    if len(arguments) != _REGISTER_ARGUMENTS_COUNT:
        return False
    handle, card_key, role, not_after_ms, voucher_signature, spend, view, sealing, card_signature, _ = arguments
    texts = (handle, card_key, voucher_signature, spend, view, sealing, card_signature)
    if not all(isinstance(item, bytes) for item in texts) or not isinstance(role, str) or len(handle) != 32:
        return False
    if type(not_after_ms) is not int or not chain_time_ms <= not_after_ms < 1 << 53:
        return False
    chain_id, sender = transaction.body.chain_id, transaction.body.sender
    if state.get(b"identity\x00handle/" + handle) is not None:
        return False
    card = chain_id + handle + sender + spend + view + sealing
    if _recovers(CARD_TAG, card_signature, card) != card_key:
        return False
    voucher = chain_id + handle + card_key + u64(not_after_ms) + role.encode()
    registrar = _recovers(VOUCHER_TAG, voucher_signature, voucher)
    return registrar is not None and state.get(b"identity\x00registrar/" + registrar) is not None


def has_standing(state: StateReader, transaction: Transaction, chain_time_ms: int) -> bool:
    """Tell whether the sender may have this transaction wait, by the finalized state and its time in ms.

    The sender must have been verified before (`Transaction.verify_sender`).
    """
    sender, body = transaction.body.sender, transaction.body
    if _is_active_member(state, sender):
        return True
    if body.contract in OWNER_CONTRACTS and state.get(b"records\x00visit/" + sender) is not None:
        return True
    if state.get(b"identity\x00custodian/" + sender) or state.get(b"identity\x00registrar/" + sender):
        return True
    if body.contract == "identity" and body.entry == "register":
        return _holds_voucher(state, transaction, chain_time_ms)
    return _is_admin(state, sender)
