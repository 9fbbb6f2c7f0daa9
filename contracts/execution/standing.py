"""Who may have a transaction wait: a pure function of the finalized state. Must never decide what a contract decides.

Standing keeps strangers from filling the pool. A sender has it as an active member (to speak of his consent, or object,
also when his organisation was removed), as the owner of a finalized visit by the key that decides of it now (for its
access, erasure, transfer and other rights only), as a grantee by the key of a grant that it names (to ask while it
stands, and to say for some time after its end that copies are gone), as a custodian, as a registrar or admin of an active
organisation, as a producer or candidate (to say that it is ready, and to accuse), or by a registration whose voucher and
card signature are good and whose handle is free.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

from consensus.errors import BlockRobotError
from consensus.limits import GRANT_NOTICE_MS
from consensus.primitives.encoding import decode_value, u64
from consensus.primitives.hashing import HASH_SIZE_BYTES
from consensus.primitives.keys import recover
from consensus.records.vouchers import CARD_TAG, VOUCHER_TAG
from consensus.transaction import Transaction
from contracts.state.view import StateReader

OWNER_ENTRIES_OF_RECORDS = frozenset({"transfer"})
GRANTEE_ENTRIES = frozenset({"request_granted", "noticed"})
PRODUCER_ENTRIES = frozenset({"ready", "accuse"})
WITHOUT_STANDING = "SENDER_WITHOUT_STANDING"
_REGISTER_ARGUMENTS_COUNT = 10
_RECOVERED_KEPT_COUNT = 256


class Reader(Protocol):
    """Whatever can be asked for the value under a flat key."""

    def get(self, key: bytes, /) -> bytes | None:
        """Return the encoded value, or None."""


def find_role(state: Reader, member: bytes) -> str:
    """Return the role that a member has now, or an empty text: what the view `identity.role_of` says.

    Only subjects outlast their organisation; who was registered before its removal stays out, should it come back.
    """
    data = state.get(b"identity\x00member/" + member)
    entry = None if data is None else decode_value(data)
    if entry is None or entry["status"] != "active":
        return ""
    removed = state.get(b"identity\x00removed/" + entry["org"].encode())
    if entry["role"] != "subject" and removed is not None and entry["since"] <= decode_value(removed):
        return ""
    return str(entry["role"])


def _is_registered(state: Reader, member: bytes) -> bool:
    """Tell whether the key is an active member's, whatever became of the organisation that let him in."""
    data = state.get(b"identity\x00member/" + member)
    return data is not None and bool(decode_value(data)["status"] == "active")


def find_root(state: Reader, key: bytes) -> bytes | None:
    """Return the first key of the visit that this key decides of now: what the view `records.root_of` says.

    None for a key of no visit, and for one that was replaced when its visit was transferred.
    """
    data = state.get(b"records\x00root/" + key)
    root = key if data is None else bytes(decode_value(data))
    if state.get(b"records\x00visit/" + root) is None:
        return None
    data = state.get(b"records\x00current/" + root)
    current = root if data is None else decode_value(data)["owner"]
    return root if current == key else None


def _owns_visit(state: Reader, owner: bytes) -> bool:
    return find_root(state, owner) is not None


def find_grant(state: Reader, grant_id: bytes, key: bytes, now_ms: int) -> dict[str, Any] | None:
    """Return the grant of this id if it is this one-time key's: while it stands, and so long after as she says what she
    deleted.

    By its id, never by the key: another grant to the same key, or a visit under it, takes nothing from this one.
    """
    data = state.get(b"access\x00grant/" + grant_id) if len(grant_id) == HASH_SIZE_BYTES else None
    grant: dict[str, Any] | None = None if data is None else decode_value(data)
    if grant is None or grant["grantee"] != key or now_ms >= grant["ended_ms"] + GRANT_NOTICE_MS:
        return None
    return grant


def _named_grant(state: Reader, transaction: Transaction, now_ms: int) -> dict[str, Any] | None:
    """Return the sender's grant that a grantee's call names first, None for any other call."""
    body = transaction.body
    if body.contract != "access" or body.entry not in GRANTEE_ENTRIES:
        return None
    try:
        arguments = transaction.arguments()
    except BlockRobotError:
        return None
    grant_id = arguments[0] if arguments else None
    return find_grant(state, grant_id, body.sender, now_ms) if isinstance(grant_id, bytes) else None


def _is_grantees_matter(state: Reader, transaction: Transaction, now_ms: int) -> bool:
    grant = _named_grant(state, transaction, now_ms)
    return grant is not None and (transaction.body.entry == "noticed" or now_ms < grant["ended_ms"])


def name_grantees(owner: bytes) -> bytes:
    """Return the account that all grantees of the visit with this first key share: their keys cost her nothing."""
    return b"grantees of " + owner


@dataclass(frozen=True, slots=True)
class Account:
    """In whose turns transactions wait, by what no holder of a key can change; it stays when keys are replaced.

    `is_of_visit` if it is a visit's, of which one person has many; `origin` names the robot that opened it, with all whose
    visits it shares what is counted of visits together. `is_shared` if many keys use it at once.
    """

    name: bytes
    is_of_visit: bool = False
    origin: bytes = b""
    is_shared: bool = False


def find_handle(state: Reader, key: bytes) -> bytes:
    """Return the handle under which this key is, or was, a member's; an empty text for a key of no member."""
    data = state.get(b"identity\x00member/" + key)
    return b"" if data is None else bytes(decode_value(data)["handle"])


def name_key(state: Reader, key: bytes) -> bytes:
    """Return what limits count for a key: its member's handle, whose admin, registrar or custodian it is, or its visit."""
    if _is_registered(state, key):
        return find_handle(state, key)
    for role in (b"custodian", b"registrar", b"admin"):
        data = state.get(b"identity\x00" + role + b"/" + key)
        if data is not None:
            entry = decode_value(data)
            return role + b" of " + str(entry if isinstance(entry, str) else entry["name"]).encode()
    if _is_producer(state, key):
        return key
    return find_root(state, key) or key


def _name_origin(state: Reader, root: bytes) -> bytes:
    """Return the name that all visits share which one robot opened."""
    data = state.get(b"records\x00visit/" + root)
    robot = b"" if data is None else bytes(decode_value(data)["robot"])
    return b"visits of " + (find_handle(state, robot) or robot)


def _find_newcomer(transaction: Transaction) -> bytes:
    """Return the handle that a registration with standing is for: its card signs as many of them as one likes."""
    try:
        handle = transaction.arguments()[0]
    except (BlockRobotError, IndexError):
        return b""
    return handle if isinstance(handle, bytes) and len(handle) == HASH_SIZE_BYTES else b""


def find_account(state: Reader, transaction: Transaction) -> Account:
    """Return in whose turns a transaction waits, and who pays for its bytes: its sender's, or all grantees' of a visit.

    For a transaction with standing only (see `find_fault`).
    """
    grant = _named_grant(state, transaction, 0)
    if grant is not None:
        root = bytes(grant["owner"])
        return Account(name_grantees(root), is_of_visit=True, origin=_name_origin(state, root), is_shared=True)
    sender = transaction.body.sender
    name = name_key(state, sender)
    # A robot may open a visit under anybody's key, which makes nobody else a visit's owner.
    is_other = _is_registered(state, sender) or _has_office(state, sender) or _is_producer(state, sender)
    if not is_other and _owns_visit(state, sender):
        return Account(name, is_of_visit=True, origin=_name_origin(state, name))
    if not is_other and is_registration(transaction):
        name = _find_newcomer(transaction) or name
    return Account(name)


_OWN_MATTERS: dict[str, Callable[[Reader, bytes], bool]] = {
    "access": _owns_visit,
    "consent": _is_registered,
    "erasure": _owns_visit,
    "records": _owns_visit,
    "rights": lambda state, sender: _owns_visit(state, sender) or _is_registered(state, sender),
}
"""Calls about oneself, and who may have them wait whatever his role."""


def _is_own_matter(state: Reader, sender: bytes, contract: str, entry: str) -> bool:
    if contract == "records" and entry not in OWNER_ENTRIES_OF_RECORDS:
        return False
    return contract in _OWN_MATTERS and _OWN_MATTERS[contract](state, sender)


def _has_office(state: Reader, sender: bytes) -> bool:
    return any(state.get(b"identity\x00" + role + b"/" + sender) for role in (b"custodian", b"registrar", b"admin"))


def _is_producer(state: Reader, sender: bytes) -> bool:
    """Tell whether the key is a producer's or candidate's, suspended ones among them."""
    data = state.get(b"producers\x00candidate/" + sender)
    return data is not None and decode_value(data)["status"] != "removed"


@lru_cache(maxsize=_RECOVERED_KEPT_COUNT)
def _recovers(tag: str, signature: Any, message: bytes) -> bytes | None:
    try:
        return recover(tag, signature, message)
    except BlockRobotError:
        return None


def _find_registration_fault(state: StateReader, transaction: Transaction, chain_time_ms: int) -> str:
    """Return why a registration has no standing (an error code), or an empty text if it has.

    What costs an elliptic-curve operation comes last, and first of that what only a registrar can have made.
    """
    arguments = transaction.arguments()
    if len(arguments) != _REGISTER_ARGUMENTS_COUNT:
        return WITHOUT_STANDING
    handle, card_key, role, not_after_ms, voucher_signature, spend, view, sealing, card_signature, _ = arguments
    texts = (handle, card_key, voucher_signature, spend, view, sealing, card_signature)
    well_formed = all(isinstance(item, bytes) for item in texts) and isinstance(role, str) and len(handle) == 32
    if not well_formed or type(not_after_ms) is not int or not 0 <= not_after_ms < 1 << 53:
        return WITHOUT_STANDING
    chain_id, sender = transaction.body.chain_id, transaction.body.sender
    if state.get(b"identity\x00handle/" + handle) is not None:
        return "HANDLE_TAKEN"
    if chain_time_ms > not_after_ms:
        return "VOUCHER_EXPIRED"
    voucher = chain_id + handle + card_key + u64(not_after_ms) + role.encode()
    registrar = _recovers(VOUCHER_TAG, voucher_signature, voucher)
    if registrar is None or state.get(b"identity\x00registrar/" + registrar) is None:
        return "VOUCHER_FOREIGN"
    card = chain_id + handle + sender + spend + view + sealing
    return "" if _recovers(CARD_TAG, card_signature, card) == card_key else "VOUCHER_FOREIGN"


def is_registration(transaction: Transaction) -> bool:
    """Tell whether it is a call by which somebody without any standing becomes a member."""
    return transaction.body.contract == "identity" and transaction.body.entry == "register"


def find_fault(state: StateReader, transaction: Transaction, chain_time_ms: int) -> str:
    """Return why the sender may not have this transaction wait, as an error code, or an empty text if he may.

    Judged by the finalized state and its time in ms, and for the sender that the transaction states: whether he signed
    it is for the caller to check (`Transaction.verify_sender`), which costs more than all that is looked up here. Only
    a registration costs elliptic-curve operations (`is_registration`).
    """
    sender, body = transaction.body.sender, transaction.body
    if find_role(state, sender):
        return ""
    is_own = _is_own_matter(state, sender, body.contract, body.entry)
    if is_own or _is_grantees_matter(state, transaction, chain_time_ms):
        return ""
    if _has_office(state, sender):
        return ""
    if body.contract == "producers" and body.entry in PRODUCER_ENTRIES and _is_producer(state, sender):
        return ""
    if is_registration(transaction):
        return _find_registration_fault(state, transaction, chain_time_ms)
    return WITHOUT_STANDING


def has_standing(state: StateReader, transaction: Transaction, chain_time_ms: int) -> bool:
    """Tell whether the sender may have this transaction wait (see `find_fault`)."""
    return not find_fault(state, transaction, chain_time_ms)


def require_standing(state: StateReader, transaction: Transaction, chain_time_ms: int) -> None:
    """Refuse a sender who may not have this transaction wait (see `find_fault`).

    Raises SENDER_WITHOUT_STANDING, or for a registration VOUCHER_FOREIGN, VOUCHER_EXPIRED or HANDLE_TAKEN.
    """
    fault = find_fault(state, transaction, chain_time_ms)
    if fault:
        raise BlockRobotError(fault)
