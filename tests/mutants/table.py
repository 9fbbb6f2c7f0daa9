"""All mutants, by where they are. `killed_by`: the tests that notice it."""

from __future__ import annotations

from tests.mutants.mutant import DroppedCheck, Mutant, Replaced

DROPPED_CHECKS: tuple[DroppedCheck, ...] = (
    DroppedCheck(
        "clients/bundle/chain_proofs.py", "PROOF_INVALID", 0, "tests/unit/clients/bundle/test_chain_proofs.py"
    ),
    DroppedCheck(
        "clients/bundle/chain_proofs.py", "PROOF_INVALID", 2, "tests/unit/clients/bundle/test_chain_proofs.py"
    ),
    DroppedCheck("consensus/block_rules.py", "BLOCK_INVALID", 0, "tests/unit/consensus/test_core_blocks.py"),
    DroppedCheck("consensus/evidence.py", "EVIDENCE_INVALID", 2, "tests/unit/consensus/test_core_evidence.py"),
    DroppedCheck("consensus/light_client.py", "PROOF_INVALID", 0, "tests/unit/consensus/test_light_client.py"),
    DroppedCheck("consensus/light_client.py", "PROOF_OTHER_EPOCH", 0, "tests/unit/consensus/test_light_client.py"),
    DroppedCheck(
        "consensus/primitives/encoding.py", "ENCODING_NOT_CANONICAL", 0, "tests/unit/consensus/test_encoding.py"
    ),
    DroppedCheck(
        "consensus/primitives/encoding.py", "ENCODING_NOT_CANONICAL", 1, "tests/unit/consensus/test_encoding.py"
    ),
    DroppedCheck("consensus/primitives/keys.py", "SIGNATURE_HIGH_S", 0, "tests/unit/consensus/test_keys.py"),
    DroppedCheck("consensus/primitives/trie.py", "PROOF_INVALID", 1, "tests/unit/consensus/test_trie.py"),
    DroppedCheck("consensus/primitives/trie.py", "PROOF_INVALID", 3, "tests/unit/consensus/test_trie.py"),
    DroppedCheck("consensus/primitives/trie.py", "PROOF_INVALID", 4, "tests/unit/consensus/test_trie.py"),
    DroppedCheck("consensus/records/clips.py", "PROOF_INVALID", 0, "tests/unit/consensus/records/test_clips.py"),
    DroppedCheck("consensus/records/clips.py", "PROOF_INVALID", 1, "tests/unit/consensus/records/test_clips.py"),
    DroppedCheck("consensus/records/handles.py", "HANDLE_MISTYPED", 0, "tests/property/test_short_handles.py"),
    DroppedCheck("consensus/records/roster.py", "ROSTER_EXPIRED", 0, "tests/unit/consensus/records/test_roster.py"),
    DroppedCheck("consensus/records/roster.py", "ROSTER_INVALID", 1, "tests/unit/consensus/records/test_roster.py"),
    DroppedCheck(
        "consensus/records/vouchers.py", "VOUCHER_EXPIRED", 0, "tests/unit/consensus/records/test_vouchers.py"
    ),
    DroppedCheck("contracts/privacy/access.py", "NOT_A_CUSTODIAN", 0, "tests/unit/contracts/privacy/test_access.py"),
    DroppedCheck(
        "contracts/privacy/access.py", "RECORD_NOT_REQUESTED", 0, "tests/unit/contracts/privacy/test_access.py"
    ),
    DroppedCheck("contracts/privacy/consent.py", "BEYOND_MANDATE", 0, "tests/unit/contracts/privacy/test_consent.py"),
    DroppedCheck("contracts/privacy/consent.py", "CALL_INDIRECT", 0, "tests/unit/contracts/privacy/test_consent.py"),
    DroppedCheck("contracts/privacy/consent.py", "NOT_THE_MEMBER", 0, "tests/unit/contracts/privacy/test_consent.py"),
    DroppedCheck("contracts/privacy/consent.py", "OWN_NO_STANDS", 0, "tests/unit/contracts/privacy/test_consent.py"),
    DroppedCheck("contracts/privacy/consent.py", "WORD_OLDER", 0, "tests/unit/contracts/privacy/test_consent.py"),
    DroppedCheck("contracts/privacy/erasure.py", "NOT_A_CUSTODIAN", 0, "tests/unit/contracts/privacy/test_erasure.py"),
    DroppedCheck("contracts/privacy/erasure.py", "NOT_A_CUSTODIAN", 1, "tests/unit/contracts/privacy/test_erasure.py"),
    DroppedCheck(
        "contracts/privacy/erasure.py", "NOT_A_DECIDING_CONTRACT", 0, "tests/unit/contracts/privacy/test_erasure.py"
    ),
    DroppedCheck("contracts/privacy/erasure.py", "RECEIPT_EXISTS", 0, "tests/unit/contracts/privacy/test_erasure.py"),
    DroppedCheck("contracts/privacy/identity.py", "NOT_THE_MEMBER", 0, "tests/unit/contracts/privacy/test_identity.py"),
    DroppedCheck(
        "contracts/privacy/identity.py", "VOUCHER_EXPIRED", 1, "tests/unit/contracts/privacy/test_identity.py"
    ),
    DroppedCheck("contracts/privacy/mandates.py", "MANDATE_LAPSED", 1, "tests/unit/contracts/privacy/test_mandates.py"),
    DroppedCheck("contracts/privacy/mandates.py", "NOT_AN_OFFICER", 0, "tests/unit/contracts/privacy/test_mandates.py"),
    DroppedCheck(
        "contracts/privacy/mandates.py", "NOT_THE_REPRESENTATIVE", 0, "tests/unit/contracts/privacy/test_mandates.py"
    ),
    DroppedCheck(
        "contracts/privacy/mandates.py", "OFFICER_CONCERNED", 0, "tests/unit/contracts/privacy/test_mandates.py"
    ),
    DroppedCheck(
        "contracts/privacy/mandates.py", "OFFICER_THE_SAME", 0, "tests/unit/contracts/privacy/test_mandates.py"
    ),
    DroppedCheck("contracts/privacy/records.py", "NOT_A_ROBOT", 0, "tests/unit/contracts/privacy/test_records.py"),
    DroppedCheck(
        "contracts/privacy/records.py", "NOT_THE_ERASURE_CONTRACT", 0, "tests/unit/contracts/privacy/test_records.py"
    ),
    DroppedCheck("contracts/privacy/records.py", "NOT_THE_OWNER", 0, "tests/unit/contracts/privacy/test_records.py"),
    DroppedCheck("contracts/privacy/records.py", "NOT_THE_ROBOT", 0, "tests/unit/contracts/privacy/test_records.py"),
    DroppedCheck(
        "contracts/privacy/records.py", "RECORD_NOT_EXPIRED", 0, "tests/unit/contracts/privacy/test_records.py"
    ),
    DroppedCheck(
        "contracts/privacy/records.py", "TRANSFER_SIGNATURE_WRONG", 0, "tests/unit/contracts/privacy/test_transfer.py"
    ),
    DroppedCheck("node/api/access.py", "NOT_PERMITTED", 0, "tests/unit/node/api/test_access.py"),
    DroppedCheck("node/api/access.py", "SESSION_REQUIRED", 0, "tests/unit/node/api/test_notice_routes.py"),
    DroppedCheck("node/api/challenges.py", "CHALLENGE_INVALID", 0, "tests/unit/node/api/test_sessions.py"),
    DroppedCheck("node/api/challenges.py", "CHALLENGE_INVALID", 1, "tests/unit/node/api/test_sessions.py"),
    DroppedCheck("node/api/routes/backgrounds.py", "UPLOAD_HASH_MISMATCH", 0, "tests/unit/node/api/test_routes.py"),
    DroppedCheck("node/api/routes/clips.py", "NOT_PERMITTED", 0, "tests/unit/node/api/test_routes.py"),
    DroppedCheck("node/api/routes/notices.py", "NOT_PERMITTED", 0, "tests/unit/node/api/test_notice_routes.py"),
    DroppedCheck("node/api/standing.py", "NOT_PERMITTED", 1, "tests/unit/node/api/test_grantee_reads.py"),
    DroppedCheck("node/mempool.py", "SENDER_LIMIT", 0, "tests/unit/node/test_mempool.py"),
    DroppedCheck("node/mempool.py", "SENDER_WITHOUT_STANDING", 0, "tests/unit/node/test_mempool.py"),
    DroppedCheck("node/mempool.py", "TRANSACTION_EXPIRED", 0, "tests/unit/node/test_mempool.py"),
    DroppedCheck("node/mempool.py", "TRANSACTION_WRONG_CHAIN", 0, "tests/unit/node/test_mempool.py"),
    DroppedCheck("node/offchain/custodian.py", "ACCESS_NOT_GRANTED", 0, "tests/offchain/test_custodian.py"),
    DroppedCheck("node/offchain/custodian.py", "ACCESS_NOT_GRANTED", 1, "tests/offchain/test_custodian.py"),
    DroppedCheck("node/offchain/custodian.py", "CLIP_ERASED", 0, "tests/offchain/test_custodian.py"),
    DroppedCheck("node/offchain/custodian.py", "CLIP_ERASED", 1, "tests/offchain/test_custodian_crashes.py"),
    DroppedCheck("node/offchain/custodian.py", "CLIP_QUARANTINED", 0, "tests/offchain/test_standing.py"),
    DroppedCheck("node/offchain/custodian.py", "CUSTODY_OUT_OF_ORDER", 1, "tests/offchain/test_custodian.py"),
    DroppedCheck("node/offchain/custodian.py", "UPLOAD_HASH_MISMATCH", 0, "tests/offchain/test_custodian.py"),
    DroppedCheck("node/offchain/erasing.py", "ERASE_KEYS_DAMAGED", 0, "tests/offchain/test_erasing_again.py"),
    DroppedCheck("node/offchain/erasing.py", "STORE_UNAVAILABLE", 0, "tests/offchain/test_erasing_again.py"),
    DroppedCheck("node/offchain/erasing.py", "STORE_UNAVAILABLE", 1, "tests/offchain/test_empty_frames.py"),
    DroppedCheck("node/offchain/erasing.py", "STORE_UNAVAILABLE", 2, "tests/offchain/test_erasing_again.py"),
    DroppedCheck("node/offchain/sharing.py", "GRANT_ENDED", 1, "tests/offchain/test_sharing_upkeep.py"),
    DroppedCheck("node/offchain/sharing.py", "NOT_PERMITTED", 0, "tests/offchain/test_sharing.py"),
    DroppedCheck("node/offchain/sharing_desk.py", "ACCESS_NOT_GRANTED", 0, "tests/offchain/test_sharing.py"),
    DroppedCheck("node/operator.py", "NOT_PERMITTED", 0, "tests/unit/node/test_operator.py"),
    DroppedCheck("node/operator.py", "OPERATOR_TOKEN_INVALID", 0, "tests/unit/node/test_operator.py"),
    DroppedCheck("node/p2p/identity.py", "PEER_CERTIFICATE_FOREIGN", 0, "tests/unit/node/p2p/test_identity.py"),
    DroppedCheck("node/p2p/identity.py", "PEER_CERTIFICATE_REVOKED", 0, "tests/unit/node/p2p/test_identity.py"),
    DroppedCheck("node/p2p/identity.py", "PEER_REMOVED", 0, "tests/unit/node/p2p/test_identity.py"),
    DroppedCheck("node/p2p/wire.py", "PEER_MESSAGE_INVALID", 3, "tests/unit/node/p2p/test_floods.py"),
    DroppedCheck("node/upload_admission.py", "EMPTY_FRAME_NOT_APPROVED", 0, "tests/unit/node/api/test_routes.py"),
)

REPLACED: tuple[Replaced, ...] = (
    Replaced(
        "contracts/vm/meter.py",
        "memory is not counted",
        "        self.memory -= size\n        self.gas",
        "        self.gas",
        "tests/unit/contracts/vm/test_meter.py",
    ),
    Replaced(
        "contracts/vm/meter.py",
        "large allocations cost as much as small ones",
        "ALLOCATION_GAS + (size >> ALLOCATION_SHIFT)",
        "ALLOCATION_GAS",
        "tests/vectors/test_contract_vectors.py",
    ),
    Replaced(
        "contracts/vm/meter.py",
        "steps cost nothing",
        "        self.gas -= gas\n        if",
        "        if",
        "tests/unit/contracts/vm/test_meter.py",
    ),
    Replaced(
        "contracts/vm/meter.py",
        "writes are not counted",
        "        self.writes_left -= 1\n",
        "",
        "tests/unit/contracts/vm/test_host.py",
    ),
    Replaced(
        "node/engine.py",
        "messages leave before the journal is synced",
        "            self._recorder.sync()\n            self._recorder.settle()",
        "            self._recorder.settle()",
        "tests/unit/node/test_engine.py",
    ),
    Replaced(
        "clients/robot/keeping.py",
        "a picture is kept without consent",
        "if isinstance(output, Kept) and refusal is None:",
        "if isinstance(output, Kept):",
        "tests/unit/clients/robot/test_keeping.py",
    ),
    Replaced(
        "clients/robot/keeping.py",
        "a clip is sealed though consent ended meanwhile",
        "            if refusal is None:\n                kept.append(frame)",
        "            if refusal is not Refusal.STALE:\n                kept.append(frame)",
        "tests/unit/clients/robot/test_keeping.py",
    ),
    Replaced(
        "clients/robot/keeping.py",
        "who refuses is told of frames, which is a record of them",
        "        may_tell = refusal is None or refusal is Refusal.STALE",
        "        may_tell = True",
        "tests/unit/clients/robot/test_keeping.py",
    ),
    Replaced(
        "clients/robot/consents.py",
        "a consent that has ended still holds",
        "        ended = consent.until_ms and taken_at_ms >= consent.until_ms",
        "        ended = False",
        "tests/unit/clients/robot/test_consents.py",
    ),
    Replaced(
        "clients/robot/consents.py",
        "a stale view of consents is used",
        "        if self._view is None or not self.is_fresh():\n            return Refusal.STALE",
        "        if self._view is None:\n            return Refusal.STALE",
        "tests/unit/clients/robot/test_consents.py",
    ),
    Replaced(
        "clients/robot/pairing.py",
        "late readings are not waited for",
        "self._waiting[0][0] + self.window_ms + self.lateness_ms < self.now_ms",
        "self._waiting[0][0] + self.window_ms < self.now_ms",
        "tests/unit/clients/robot/test_pairing.py",
    ),
    Replaced(
        "clients/robot/pairing.py",
        "a tag that left is still there",
        "        return place >= 0 and at <= self._ends[place]",
        "        return place >= 0",
        "tests/unit/clients/robot/test_pairing.py",
    ),
    Replaced(
        "clients/robot/hiding/cut.py",
        "pixels of others are not fenced off",
        "    if others.any():",
        "    if False:",
        "tests/unit/clients/robot/hiding/test_cut.py",
    ),
    Replaced(
        "clients/robot/hiding/cut.py",
        "a silhouette takes what stands far behind it",
        "    mask[(pixels < low_mm) | (pixels > high_mm)] = 0\n",
        "",
        "tests/unit/clients/robot/hiding/test_cut.py",
    ),
    Replaced(
        "node/offchain/erasing.py",
        "rows go, the keys of shared parts stay",
        "        await asyncio.to_thread(self._keys.destroy, slots)\n"
        "        self._is_swept = False\n        await self._store.erase_parts(slots)",
        "        self._is_swept = False\n        await self._store.erase_parts(slots)",
        "tests/offchain/test_sharing_ends.py",
    ),
    Replaced(
        "node/offchain/erasing.py",
        "what is erased again is not read back",
        "        await self._read_back(parts)\n"
        "        await asyncio.to_thread(self._keys.release, slots)\n\n    async def forget",
        "        await asyncio.to_thread(self._keys.release, slots)\n\n    async def forget",
        "tests/offchain/test_erasing_again.py",
    ),
    Replaced(
        "consensus/light_client.py",
        "a child of any later round makes final",
        "child.round == headers[-2].round + 1",
        "child.round > headers[-2].round",
        "tests/unit/consensus/test_light_client.py",
    ),
    Replaced(
        "consensus/light_client.py",
        "a header's certificate may be another's",
        "qc.block_id == block_id and qc.round == each.round",
        "qc.round == each.round",
        "tests/unit/consensus/test_light_client.py",
    ),
    Replaced(
        "consensus/primitives/merkle.py",
        "a proof may be longer than its tree",
        "return used == len(proof) and tagged_hash",
        "return tagged_hash",
        "tests/unit/consensus/test_merkle.py",
    ),
    Replaced(
        "consensus/block_rules.py",
        "any producer may lead a round",
        "header.producer == schedule.leader(header.round)",
        "header.producer < len(schedule.producers)",
        "tests/unit/consensus/test_core_blocks.py",
    ),
    Replaced(
        "consensus/block_rules.py",
        "transactions need not be the header's",
        "compute_transactions_root(txids) == header.transactions_root",
        "True",
        "tests/unit/consensus/test_core_blocks.py",
    ),
    Replaced(
        "pages/local_page.py",
        "another web page may change something",
        "        if origin != self._origin and (origin is not None or request.method not in _SAFE_METHODS):",
        "        if False:",
        "tests/security/test_console_page.py",
    ),
    Replaced(
        "pages/local_page.py",
        "any name of this machine opens the page",
        '        if request.headers.get("Host", "") != self._origin.removeprefix("http://"):',
        "        if False:",
        "tests/security/test_wallet_page_guard.py",
    ),
    Replaced(
        "clients/sdk/safe_output.py",
        "controls of others reach the terminal",
        "        self._stream.write(escape_controls(text, _ALLOWED))",
        "        self._stream.write(text)",
        "tests/unit/clients/sdk/test_safe_output.py",
    ),
    Replaced(
        "clients/robot/sealed_file.py",
        "a sealed file is for everybody on the machine",
        "            os.fchmod(file.fileno(), 0o600)",
        "            os.fchmod(file.fileno(), 0o644)",
        "tests/unit/clients/robot/test_identity.py",
    ),
    Replaced(
        "node/process_memory.py",
        "secrets are not wiped",
        "        ctypes.memset(id(secret) + _DATA_AT, 0, len(secret))",
        "        pass",
        "tests/unit/node/test_process_memory.py",
    ),
    Replaced(
        "consensus/genuineness.py",
        "votes are not checked",
        "        return self._check(self._schedule.producers[vote.index], VOTE_TAG, vote.signature, *parts)",
        "        return True",
        "tests/unit/consensus/test_core_blocks.py",
    ),
    Replaced(
        "clients/robot/hiding/cut.py",
        "a cut keeps the room behind the person",
        "    return CutOut(x0, y0, np.where(mask > 0, pixels, np.uint16(0)))",
        "    return CutOut(x0, y0, pixels)",
        "tests/unit/clients/robot/hiding/test_cut.py",
    ),
    Replaced(
        "clients/robot/hiding/match_evidence.py",
        "a tag is bound on little evidence",
        "BIND_LOG_ODDS = 9.2",
        "BIND_LOG_ODDS = 0.2",
        "tests/unit/clients/robot/hiding/test_matcher.py",
    ),
)

MUTANTS: tuple[Mutant, ...] = (*DROPPED_CHECKS, *REPLACED)
