"""Checks that never refuse any more. `killed_by`: the tests that notice it."""

from __future__ import annotations

from tests.mutants.mutant import DroppedCheck, Kind

DROPPED_CHECKS: tuple[DroppedCheck, ...] = (
    DroppedCheck(
        Kind.PROOFS,
        "clients/bundle/checks/chain_proofs.py",
        "PROOF_INVALID",
        0,
        "tests/unit/clients/bundle/test_chain_proofs.py",
    ),
    DroppedCheck(
        Kind.PROOFS,
        "clients/bundle/checks/chain_proofs.py",
        "PROOF_INVALID",
        2,
        "tests/unit/clients/bundle/test_chain_proofs.py",
    ),
    DroppedCheck(
        Kind.VOTING, "consensus/chain/block_rules.py", "BLOCK_INVALID", 0, "tests/unit/consensus/test_core_blocks.py"
    ),
    DroppedCheck(
        Kind.VOTING, "consensus/chain/evidence.py", "EVIDENCE_INVALID", 2, "tests/unit/consensus/test_core_evidence.py"
    ),
    DroppedCheck(
        Kind.PROOFS, "consensus/chain/light_client.py", "PROOF_INVALID", 0, "tests/unit/consensus/test_light_client.py"
    ),
    DroppedCheck(
        Kind.PROOFS,
        "consensus/chain/light_client.py",
        "PROOF_OTHER_EPOCH",
        0,
        "tests/unit/consensus/test_light_client.py",
    ),
    DroppedCheck(
        Kind.PROOFS,
        "consensus/primitives/encoding.py",
        "ENCODING_NOT_CANONICAL",
        0,
        "tests/unit/consensus/test_encoding.py",
    ),
    DroppedCheck(
        Kind.PROOFS,
        "consensus/primitives/encoding.py",
        "ENCODING_NOT_CANONICAL",
        1,
        "tests/unit/consensus/test_encoding.py",
    ),
    DroppedCheck(
        Kind.PROOFS, "consensus/primitives/keys.py", "SIGNATURE_HIGH_S", 0, "tests/unit/consensus/test_keys.py"
    ),
    DroppedCheck(Kind.PROOFS, "consensus/primitives/trie.py", "PROOF_INVALID", 1, "tests/unit/consensus/test_trie.py"),
    DroppedCheck(Kind.PROOFS, "consensus/primitives/trie.py", "PROOF_INVALID", 3, "tests/unit/consensus/test_trie.py"),
    DroppedCheck(Kind.PROOFS, "consensus/primitives/trie.py", "PROOF_INVALID", 4, "tests/unit/consensus/test_trie.py"),
    DroppedCheck(
        Kind.PROOFS, "consensus/records/clips.py", "PROOF_INVALID", 0, "tests/unit/consensus/records/test_clips.py"
    ),
    DroppedCheck(
        Kind.PROOFS, "consensus/records/clips.py", "PROOF_INVALID", 1, "tests/unit/consensus/records/test_clips.py"
    ),
    DroppedCheck(
        Kind.PROOFS, "consensus/members/handles.py", "HANDLE_MISTYPED", 0, "tests/property/test_short_handles.py"
    ),
    DroppedCheck(
        Kind.PROOFS, "consensus/members/roster.py", "ROSTER_EXPIRED", 0, "tests/unit/consensus/records/test_roster.py"
    ),
    DroppedCheck(
        Kind.PROOFS, "consensus/members/roster.py", "ROSTER_INVALID", 1, "tests/unit/consensus/records/test_roster.py"
    ),
    DroppedCheck(
        Kind.PROOFS,
        "consensus/members/vouchers.py",
        "VOUCHER_EXPIRED",
        0,
        "tests/unit/consensus/records/test_vouchers.py",
    ),
    DroppedCheck(
        Kind.AUTHORISATION,
        "contracts/privacy/access.py",
        "NOT_A_CUSTODIAN",
        0,
        "tests/security/test_authorisation_entries.py::test_each_role_may_do_what_the_rule_says_and_no_more[access.released]",
    ),
    DroppedCheck(
        Kind.AUTHORISATION,
        "contracts/privacy/access.py",
        "RECORD_NOT_REQUESTED",
        0,
        "tests/unit/contracts/privacy/test_access.py",
    ),
    DroppedCheck(
        Kind.MANDATES,
        "contracts/privacy/consent.py",
        "BEYOND_MANDATE",
        0,
        "tests/unit/contracts/privacy/test_mandates.py",
    ),
    DroppedCheck(
        Kind.CONSENT, "contracts/privacy/consent.py", "CALL_INDIRECT", 0, "tests/unit/contracts/privacy/test_consent.py"
    ),
    DroppedCheck(
        Kind.CONSENT,
        "contracts/privacy/consent.py",
        "NOT_THE_MEMBER",
        0,
        "tests/unit/contracts/privacy/test_consent.py",
    ),
    DroppedCheck(
        Kind.CONSENT,
        "contracts/privacy/consent.py",
        "OWN_NO_STANDS",
        0,
        "tests/unit/contracts/privacy/test_mandates.py",
    ),
    DroppedCheck(
        Kind.CONSENT,
        "contracts/privacy/consent.py",
        "WORD_OLDER",
        0,
        "tests/unit/contracts/privacy/test_consent_order.py",
    ),
    DroppedCheck(
        Kind.ERASURE,
        "contracts/privacy/erasure.py",
        "NOT_A_CUSTODIAN",
        0,
        "tests/unit/contracts/privacy/test_erasure.py",
    ),
    DroppedCheck(
        Kind.ERASURE,
        "contracts/privacy/erasure.py",
        "NOT_A_CUSTODIAN",
        1,
        "tests/unit/contracts/privacy/test_erasure.py",
    ),
    DroppedCheck(
        Kind.ERASURE,
        "contracts/privacy/erasure.py",
        "NOT_A_DECIDING_CONTRACT",
        0,
        "tests/security/test_authorisation_entries.py::test_only_the_contracts_of_the_rule_may_call_it_in_somebodys_name[erasure.order]",
    ),
    DroppedCheck(
        Kind.ERASURE,
        "contracts/privacy/erasure.py",
        "RECEIPT_EXISTS",
        0,
        "tests/unit/contracts/privacy/test_erasure.py",
    ),
    DroppedCheck(
        Kind.AUTHORISATION,
        "contracts/privacy/identity.py",
        "NOT_THE_MEMBER",
        0,
        "tests/unit/contracts/privacy/test_identity.py",
    ),
    DroppedCheck(
        Kind.AUTHORISATION,
        "contracts/privacy/identity.py",
        "VOUCHER_EXPIRED",
        1,
        "tests/unit/contracts/privacy/test_identity.py",
    ),
    DroppedCheck(
        Kind.MANDATES,
        "contracts/privacy/mandates.py",
        "MANDATE_LAPSED",
        1,
        "tests/unit/contracts/privacy/test_mandate_ends.py",
    ),
    DroppedCheck(
        Kind.MANDATES,
        "contracts/privacy/mandates.py",
        "NOT_AN_OFFICER",
        0,
        "tests/unit/contracts/privacy/test_mandates.py",
    ),
    DroppedCheck(
        Kind.MANDATES,
        "contracts/privacy/mandates.py",
        "NOT_THE_REPRESENTATIVE",
        0,
        "tests/unit/contracts/privacy/test_mandates.py",
    ),
    DroppedCheck(
        Kind.MANDATES,
        "contracts/privacy/mandates.py",
        "OFFICER_CONCERNED",
        0,
        "tests/unit/contracts/privacy/test_mandates.py",
    ),
    DroppedCheck(
        Kind.MANDATES,
        "contracts/privacy/mandates.py",
        "OFFICER_THE_SAME",
        0,
        "tests/unit/contracts/privacy/test_mandates.py",
    ),
    DroppedCheck(
        Kind.AUTHORISATION,
        "contracts/privacy/records.py",
        "NOT_A_ROBOT",
        0,
        "tests/security/test_authorisation_entries.py::test_each_role_may_do_what_the_rule_says_and_no_more[records.open_visit]",
    ),
    DroppedCheck(
        Kind.ERASURE,
        "contracts/privacy/records.py",
        "NOT_THE_ERASURE_CONTRACT",
        0,
        "tests/security/test_authorisation_entries.py::test_only_the_contracts_of_the_rule_may_call_it_in_somebodys_name[records.begin_erasure]",
    ),
    DroppedCheck(
        Kind.AUTHORISATION,
        "contracts/privacy/records.py",
        "NOT_THE_OWNER",
        0,
        "tests/unit/contracts/privacy/test_access.py",
    ),
    DroppedCheck(
        Kind.AUTHORISATION,
        "contracts/privacy/records.py",
        "NOT_THE_ROBOT",
        0,
        "tests/security/test_authorisation_entries.py::test_each_role_may_do_what_the_rule_says_and_no_more[records.record]",
    ),
    DroppedCheck(
        Kind.ERASURE,
        "contracts/privacy/records.py",
        "RECORD_NOT_EXPIRED",
        0,
        "tests/unit/contracts/privacy/test_erasure.py",
    ),
    DroppedCheck(
        Kind.AUTHORISATION,
        "contracts/privacy/records.py",
        "TRANSFER_SIGNATURE_WRONG",
        0,
        "tests/unit/contracts/privacy/test_transfer.py",
    ),
    DroppedCheck(
        Kind.AUTHORISATION, "node/api/access/route_access.py", "NOT_PERMITTED", 0, "tests/unit/node/api/test_access.py"
    ),
    DroppedCheck(
        Kind.AUTHORISATION,
        "node/api/access/route_access.py",
        "SESSION_REQUIRED",
        0,
        "tests/unit/node/api/test_notice_routes.py",
    ),
    DroppedCheck(
        Kind.AUTHORISATION,
        "node/api/access/challenges.py",
        "CHALLENGE_INVALID",
        0,
        "tests/unit/node/api/test_sessions.py",
    ),
    DroppedCheck(
        Kind.AUTHORISATION,
        "node/api/access/challenges.py",
        "CHALLENGE_INVALID",
        1,
        "tests/unit/node/api/test_sessions.py",
    ),
    DroppedCheck(
        Kind.PROOFS,
        "node/api/routes/custody/backgrounds.py",
        "UPLOAD_HASH_MISMATCH",
        0,
        "tests/unit/node/api/test_routes.py",
    ),
    DroppedCheck(
        Kind.AUTHORISATION, "node/api/routes/custody/clips.py", "NOT_PERMITTED", 0, "tests/unit/node/api/test_routes.py"
    ),
    DroppedCheck(
        Kind.AUTHORISATION,
        "node/api/routes/notices.py",
        "NOT_PERMITTED",
        0,
        "tests/unit/node/api/test_notice_routes.py",
    ),
    DroppedCheck(
        Kind.AUTHORISATION,
        "node/api/access/principals.py",
        "NOT_PERMITTED",
        1,
        "tests/unit/node/api/test_grantee_reads.py",
    ),
    DroppedCheck(Kind.QUOTAS, "node/mempool/mempool.py", "SENDER_LIMIT", 0, "tests/unit/node/test_mempool.py"),
    DroppedCheck(Kind.QUOTAS, "node/mempool/mempool.py", "SENDER_NOT_ADMITTED", 0, "tests/unit/node/test_mempool.py"),
    DroppedCheck(Kind.QUOTAS, "node/mempool/mempool.py", "TRANSACTION_EXPIRED", 0, "tests/unit/node/test_mempool.py"),
    DroppedCheck(
        Kind.QUOTAS, "node/mempool/mempool.py", "TRANSACTION_WRONG_CHAIN", 0, "tests/unit/node/test_mempool.py"
    ),
    DroppedCheck(
        Kind.AUTHORISATION, "node/custody/custodian.py", "ACCESS_NOT_GRANTED", 0, "tests/offchain/test_custodian.py"
    ),
    DroppedCheck(
        Kind.AUTHORISATION, "node/custody/custodian.py", "ACCESS_NOT_GRANTED", 1, "tests/offchain/test_custodian.py"
    ),
    DroppedCheck(Kind.ERASURE, "node/custody/custodian.py", "CLIP_ERASED", 0, "tests/offchain/test_custodian.py"),
    DroppedCheck(
        Kind.ERASURE, "node/custody/custodian.py", "CLIP_ERASED", 1, "tests/offchain/test_custodian_crashes.py"
    ),
    DroppedCheck(
        Kind.AUTHORISATION, "node/custody/custodian.py", "CLIP_QUARANTINED", 0, "tests/offchain/test_standing.py"
    ),
    DroppedCheck(
        Kind.ERASURE, "node/custody/custodian.py", "CUSTODY_OUT_OF_ORDER", 1, "tests/offchain/test_custodian.py"
    ),
    DroppedCheck(
        Kind.PROOFS, "node/custody/custodian.py", "UPLOAD_HASH_MISMATCH", 0, "tests/offchain/test_custodian.py"
    ),
    DroppedCheck(
        Kind.ERASURE, "node/custody/erasure.py", "ERASE_KEYS_DAMAGED", 0, "tests/offchain/test_erasing_again.py"
    ),
    DroppedCheck(
        Kind.ERASURE, "node/custody/erasure.py", "STORE_UNAVAILABLE", 0, "tests/offchain/test_erasing_again.py"
    ),
    DroppedCheck(
        Kind.ERASURE, "node/custody/erasure.py", "STORE_UNAVAILABLE", 1, "tests/offchain/test_empty_frames.py"
    ),
    DroppedCheck(
        Kind.ERASURE, "node/custody/erasure.py", "STORE_UNAVAILABLE", 2, "tests/offchain/test_erasing_again.py"
    ),
    DroppedCheck(Kind.ERASURE, "node/custody/shares.py", "GRANT_ENDED", 1, "tests/offchain/test_sharing_upkeep.py"),
    DroppedCheck(Kind.AUTHORISATION, "node/custody/shares.py", "NOT_PERMITTED", 0, "tests/offchain/test_sharing.py"),
    DroppedCheck(
        Kind.AUTHORISATION, "node/custody/share_service.py", "ACCESS_NOT_GRANTED", 0, "tests/offchain/test_sharing.py"
    ),
    DroppedCheck(Kind.AUTHORISATION, "node/operator.py", "NOT_PERMITTED", 0, "tests/unit/node/test_operator.py"),
    DroppedCheck(
        Kind.AUTHORISATION, "node/operator.py", "OPERATOR_TOKEN_INVALID", 0, "tests/unit/node/test_operator.py"
    ),
    DroppedCheck(
        Kind.PROOFS, "node/p2p/identity.py", "PEER_CERTIFICATE_FOREIGN", 0, "tests/unit/node/p2p/test_identity.py"
    ),
    DroppedCheck(
        Kind.PROOFS, "node/p2p/identity.py", "PEER_CERTIFICATE_REVOKED", 0, "tests/unit/node/p2p/test_identity.py"
    ),
    DroppedCheck(Kind.PROOFS, "node/p2p/identity.py", "PEER_REMOVED", 0, "tests/unit/node/p2p/test_identity.py"),
    DroppedCheck(Kind.QUOTAS, "node/p2p/wire.py", "PEER_MESSAGE_INVALID", 3, "tests/unit/node/p2p/test_wire.py"),
    DroppedCheck(
        Kind.AUTHORISATION,
        "node/custody/chain/upload_admission.py",
        "EMPTY_FRAME_NOT_APPROVED",
        0,
        "tests/unit/node/api/test_frame_approval.py",
    ),
)
