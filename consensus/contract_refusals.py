"""Next steps for CALL_REFUSED, by the shipped contracts' own codes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import MappingProxyType

_RECORDS = "See what there is with `blockrobot wallet records`."
_BREACHES = "`blockrobot officer breaches` shows how far it is, and the next step."
_LOST_KEYS = "`blockrobot officer lost-keys list` shows how far it is, and the next step."
_MANDATES = "`blockrobot wallet mandates list --all`, or `blockrobot officer mandates list --all`, shows how far it is."
_CARD = "Ask the hospital's desk for a new card."
_ENTRIES = "`blockrobot contract show NAME --abi` shows the entries and what they take."

NEXT_STEPS: Mapping[str, str] = MappingProxyType(
    {
        # Purposes
        "PURPOSE_UNKNOWN": "Choose one of the `purposes` that the network's genesis file names.",
        "PURPOSE_OBJECTED": "You objected to this purpose for past visits; choose another, such as `own-access`.",
        "PURPOSE_OWN": "Leave that purpose out: it is what lets you see your own records.",
        # Records and visits
        "RECORD_ERASED": f"It is gone, or going: nothing is left to do. {_RECORDS}",
        "RECORD_UNKNOWN": _RECORDS,
        "RECORD_RESTRICTED": "Only its owner can change that: `blockrobot wallet lift`, or look for `own-access`.",
        "NOT_RESTRICTED": _RECORDS,
        "RESTRICTED_WHOLE": "Lift the whole visit: `blockrobot wallet lift --visit NAME`.",
        "RESTRICTION_STANDS": "Lift it first (`blockrobot wallet lift`), or restrict on the same kind of ground.",
        "WORDS_TOO_MANY": "Go on tomorrow (UTC). Erasing, moving a visit, ending a share and saying no go on.",
        "VISIT_QUARANTINED": "Wait until an officer has decided; `blockrobot wallet records` tells the outcome.",
        "VISIT_TRANSFERRED": "Use the wallet that it was transferred to.",
        "NOT_THE_OWNER": "Use the wallet of the person who was recorded.",
        # Empty frames
        "EMPTY_FRAMES_TOO_MANY": "Withdraw some on which no record stands any more: `blockrobot frames list`, `withdraw`.",
        "EMPTY_FRAME_UNKNOWN": "See which are approved with `blockrobot frames list`.",
        "NOT_OF_THE_ORGANISATION": "Name an admin of the robot's organisation: `--as ORG`, or `--key FILE`.",
        "ROBOT_UNKNOWN": "Name the member key that `blockrobot robot register` printed.",
        # Cards and members
        "VOUCHER_EXPIRED": f"The card's code is too old. {_CARD}",
        "HANDLE_TAKEN": f"Somebody registered with this card already. If that was not you: {_CARD[0].lower()}{_CARD[1:]}",
        "CARD_SIGNATURE_WRONG": _CARD,
        "NOT_A_REGISTRAR": _CARD,
        "MEMBER_EXISTS": (
            "The key is registered already: go on with `blockrobot wallet records`; for a robot with `blockrobot robot "
            "replay` or `blockrobot robot run`."
        ),
        "MEMBER_NOT_ACTIVE": f"The membership has ended. {_CARD}",
        "ROBOT_NAME_WRONG": "Give another: `blockrobot card name --help` says what a name and a place may hold.",
        # Officers
        "NOT_AN_OFFICER": "Use the wallet of an officer of the organisation whose robot it was: `officer --profile NAME`.",
        "BREACH_NOT_ASSESSED": "Assess it first: `blockrobot officer assess`.",
        "BREACH_NOT_NOTIFIED": "Tell those whom it concerns, and note it: `blockrobot officer notify`.",
        "BREACH_CLOSED": "It is over: nothing is left to do. `blockrobot officer breaches --all` shows it.",
        "BREACH_UNKNOWN": _BREACHES,
        "NOTIFIED_ALREADY": _BREACHES,
        "RISK_LOWERED": _BREACHES,
        "DELAY_UNEXPLAINED": "Name the reason: --reason facts-came-late, or officer-unreachable.",
        "RECORDS_LEFT": "More came meanwhile: say `blockrobot officer close` once more.",
        "OFFICER_THE_SAME": "Let another officer approve it, with a wallet of their own.",
        "OFFICER_GONE": "Two who are officers now propose and approve it anew.",
        "NOT_OF_THE_TWO": "Let one of the two officers who decided it do that.",
        "NOT_APPROVED": _LOST_KEYS,
        "PROPOSAL_DECIDED": _LOST_KEYS,
        "PROPOSAL_LAPSED": "Propose it anew: `blockrobot officer lost-keys propose`.",
        "SPAN_WRONG": "Name minutes that are over, an hour at most: see `blockrobot officer lost-keys preview`.",
        "VISITS_TOO_MANY": "Propose the rest anew: `blockrobot officer lost-keys propose`.",
        # Mandates
        "MANDATE_EXISTS": "End that one first: `blockrobot officer mandates list`, then `blockrobot officer mandates end`.",
        "MANDATE_DECIDED": _MANDATES,
        "MANDATE_LAPSED": "Propose it anew: `blockrobot officer mandates propose`.",
        "MANDATE_ENDED": _MANDATES,
        "MANDATE_HOLDS": _MANDATES,
        "MANDATE_UNKNOWN": _MANDATES,
        "NOT_OF_THE_MANDATE": "Let one of the two persons or an officer of their organisation end it.",
        "NOT_THE_REPRESENTATIVE": "Use the wallet of the person whom the mandate names: `blockrobot wallet mandates list`.",
        "OFFICER_CONCERNED": "Let two other officers give it.",
        "REPRESENTED_WRONG": "Name the handle of a person with a card of their own, as their `wallet handle` shows it.",
        "REPRESENTATIVE_WRONG": "Name the handle of another subject, member of the staff or officer for whom nobody acts.",
        "BEYOND_MANDATE": "Name an earlier end with --until: `blockrobot wallet mandates list` shows the mandate's.",
        "OWN_NO_STANDS": "Leave that purpose out, or end it with the person's own yes: for more it takes the own wallet.",
        # Sharing
        "GRANT_ENDED": "It has ended; nothing is left to do. See `blockrobot wallet shares`, or `blockrobot wallet inbox`.",
        "GRANT_UNKNOWN": "What you share: `blockrobot wallet shares`; what is shared with you: `blockrobot wallet inbox`.",
        "GRANTS_TOO_MANY": "End one that you need no more: `blockrobot wallet shares`, then `blockrobot wallet revoke`.",
        "RECORD_NOT_GRANTED": "`blockrobot wallet inbox` shows which records were shared with you.",
        # Any contract
        "ARGUMENTS_INVALID": _ENTRIES,
        "ENTRY_UNKNOWN": _ENTRIES,
        "CALL_INDIRECT": "Call the entry by a transaction of your own, not through another contract.",
    }
)

_CODE = re.compile(r"([A-Z][A-Z0-9]*(?:_[A-Z0-9]+)+)(?::|$)")


def refusal_code(contract_code: str, detail: str) -> str:
    found = _CODE.match(detail)
    return contract_code or (found.group(1) if found else "")


def find_next_step(contract_code: str, detail: str) -> str:
    return NEXT_STEPS.get(refusal_code(contract_code, detail), "")
