"""What the chain decides: proofs, voting, the journal."""

from __future__ import annotations

from tests.mutants.mutant import Kind, Replaced

REPLACED: tuple[Replaced, ...] = (
    Replaced(
        Kind.PROOFS,
        "consensus/chain/light_client.py",
        "a child of any later round makes final",
        "child.round == headers[-2].round + 1",
        "child.round > headers[-2].round",
        "tests/unit/consensus/test_light_client.py",
    ),
    Replaced(
        Kind.PROOFS,
        "consensus/chain/light_client.py",
        "a header's certificate may be another's",
        "qc.block_id == block_id and qc.round == each.round",
        "qc.round == each.round",
        "tests/unit/consensus/test_light_client.py",
    ),
    Replaced(
        Kind.PROOFS,
        "consensus/primitives/merkle.py",
        "a proof may be longer than its tree",
        "return used == len(proof) and tagged_hash",
        "return tagged_hash",
        "tests/unit/consensus/test_merkle.py",
    ),
    Replaced(
        Kind.PROOFS,
        "consensus/chain/light_client.py",
        "a next epoch is believed whatever the boundary names",
        "boundary.next_schedule_hash == compute_epoch_hash(proof.epoch)",
        "boundary.next_schedule_hash is not None",
        "tests/unit/consensus/test_light_client_epochs.py",
    ),
    Replaced(
        Kind.PROOFS,
        "consensus/chain/light_client.py",
        "a closing block is final",
        '    _require(not header.is_closing, "A block that closes its epoch is never final.")\n',
        "",
        "tests/unit/consensus/test_light_client_epochs.py",
    ),
    Replaced(
        Kind.PROOFS,
        "consensus/chain/light_client.py",
        "a known epoch may have another boundary",
        (
            "            and known.epoch == proof.epoch\n"
            "            and known.finality.header_bytes == proof.finality.header_bytes,\n"
        ),
        "            and known.epoch == proof.epoch,\n",
        "tests/unit/consensus/test_light_client_epochs.py",
    ),
    Replaced(
        Kind.PROOFS,
        "consensus/chain/light_client.py",
        "a node's value is not looked up in the state",
        "        verify_proof(header.state_root, key, value, state_proof)\n",
        "",
        "tests/unit/consensus/test_light_client.py",
    ),
    Replaced(
        Kind.PROOFS,
        "consensus/chain/light_client.py",
        "an older header is pinned over a newer one",
        (
            "        if self._is_older(header):\n"
            '            raise self._stale(f"The proof is about height {header.height}.")\n'
            "        self._pin(header, proof.header_bytes)"
        ),
        "        if not self._is_older(header):\n            self._pin(header, proof.header_bytes)",
        "tests/unit/consensus/test_light_client.py",
    ),
    Replaced(
        Kind.PROOFS,
        "consensus/primitives/merkle.py",
        "a leaf stands beyond the end of its list",
        "if not 0 <= index < count < 1 << 32 or",
        "if not 0 <= count < 1 << 32 or",
        "tests/unit/consensus/test_merkle.py",
    ),
    Replaced(
        Kind.PROOFS,
        "consensus/primitives/merkle.py",
        "a list's length is not in its root",
        "return tagged_hash(_ROOT, u32(len(leaves)), level[0]",
        "return tagged_hash(_ROOT, u32(0), level[0]",
        "tests/unit/consensus/test_merkle.py",
    ),
    Replaced(
        Kind.PROOFS,
        "consensus/primitives/trie.py",
        "a slot is both a leaf and a branch",
        "return not leaves & branches and len(page) == size",
        "return len(page) == size",
        "tests/unit/consensus/test_trie.py",
    ),
    Replaced(
        Kind.PROOFS,
        "consensus/chain/schedule.py",
        "a certificate counts one vote twice",
        "any(first >= second for first, second in itertools.pairwise(indexes))",
        "any(first > second for first, second in itertools.pairwise(indexes))",
        "tests/unit/consensus/test_schedule.py",
    ),
    Replaced(
        Kind.PROOFS,
        "consensus/chain/schedule.py",
        "a timeout names a certificate of its own round",
        "if not 0 <= timeout.qc_round < tc.round or not check(",
        "if not 0 <= timeout.qc_round <= tc.round or not check(",
        "tests/unit/consensus/test_schedule.py tests/unit/consensus/test_core_timeouts.py",
    ),
    Replaced(
        Kind.PROOFS,
        "consensus/records/png.py",
        "a damaged part of a picture is taken",
        (
            "        if zlib.crc32(content[at + 4 : end - 4]) != int.from_bytes(content[end - 4 : "
            'end], "big"):\n            raise _refuse("A part of it is damaged.")\n'
        ),
        "",
        "tests/unit/consensus/records/test_png.py",
    ),
    Replaced(
        Kind.PROOFS,
        "consensus/records/png.py",
        "other bytes hide behind a picture's pixels",
        "or not unpacking.eof or unpacking.unused_data:",
        "or not unpacking.eof:",
        "tests/unit/consensus/records/test_png.py",
    ),
    Replaced(
        Kind.PROOFS,
        "consensus/records/png.py",
        "a picture is unpacked beyond its size",
        ", height * row_bytes + 1)",
        ")",
        "tests/unit/consensus/records/test_png.py",
    ),
    Replaced(
        Kind.PROOFS,
        "consensus/records/clips.py",
        "frames of a clip come in any order",
        " or [frame.index for frame in download.frames] != list(range(count)):",
        ":",
        "tests/unit/consensus/records/test_clips.py",
    ),
    Replaced(
        Kind.PROOFS,
        "consensus/records/clips.py",
        "a frame is not held against its leaf",
        "        if not frame.erased and ciphertext_leaf(",
        "        if frame.erased and ciphertext_leaf(",
        "tests/unit/consensus/records/test_clips.py",
    ),
    Replaced(
        Kind.PROOFS,
        "node/custody/custodian.py",
        "a damaged copy of another custodian is kept",
        "        if damaged:\n",
        "        if False:\n",
        "tests/offchain/test_fetching.py",
    ),
    Replaced(
        Kind.PROOFS,
        "node/p2p/identity.py",
        "a certificate that has expired lets a peer in",
        "    if facts.is_expired(now_ms):\n",
        "    if False:\n",
        "tests/unit/node/p2p/test_identity.py",
    ),
    Replaced(
        Kind.PROOFS,
        "node/p2p/identity.py",
        "any organisation's CA vouches for a node",
        (
            "    organisation = directory.organisations.get(node.organisation)\n"
            "    authorities = () if organisation is None else load_authorities(organisation.ca_certificate)\n"
        ),
        (
            "    authorities = [one for each in directory.organisations.values() for one in "
            "load_authorities(each.ca_certificate)]\n"
        ),
        "tests/unit/node/p2p/test_identity.py",
    ),
    Replaced(
        Kind.PROOFS,
        "clients/bundle/checks/signed_receipts.py",
        "a receipt may be of a consent that no proof shows",
        "if not is_registering(entry) and (word.txid.hex(), word.status, word.height) not in proved:",
        "if False:",
        "tests/unit/clients/bundle/test_signed_receipts.py",
    ),
    Replaced(
        Kind.PROOFS,
        "clients/bundle/checks/bundle_check.py",
        "files of a bundle are not those that its manifest lists",
        "            if row != found:\n",
        "            if row[0] != found[0]:\n",
        "tests/unit/clients/bundle/test_forging.py",
    ),
    Replaced(
        Kind.VOTING,
        "consensus/chain/block_rules.py",
        "any producer may lead a round",
        "header.producer == schedule.leader(header.round)",
        "header.producer < len(schedule.producers)",
        "tests/unit/consensus/test_core_blocks.py",
    ),
    Replaced(
        Kind.VOTING,
        "consensus/chain/block_rules.py",
        "transactions need not be the header's",
        "compute_transactions_root(txids) == header.transactions_root",
        "True",
        "tests/unit/consensus/test_core_blocks.py",
    ),
    Replaced(
        Kind.VOTING,
        "consensus/chain/message_checks.py",
        "votes are not checked",
        ("        return self._check(self._schedule.producers[vote.index], VOTE_TAG, vote.signature, *parts)"),
        "        return True",
        "tests/unit/consensus/test_core_blocks.py",
    ),
    Replaced(
        Kind.VOTING,
        "consensus/protocol/vote_collectors.py",
        "one producer's votes for two blocks both count",
        "        if vote.index in votes:\n            return None\n",
        "",
        "tests/unit/consensus/test_collectors.py",
    ),
    Replaced(
        Kind.VOTING,
        "consensus/protocol/vote_collectors.py",
        "votes for any block of a round make a certificate",
        " for index, other in votes.items() if other.block_id == vote.block_id)",
        " for index, other in votes.items())",
        "tests/unit/consensus/test_collectors.py",
    ),
    Replaced(
        Kind.VOTING,
        "consensus/protocol/voter.py",
        "a block from the future gets a vote",
        "            and header.timestamp_ms <= now_ms + self._settings.max_clock_drift_ms\n",
        "",
        "tests/unit/consensus/test_core_votes.py",
    ),
    Replaced(
        Kind.VOTING,
        "consensus/protocol/voter.py",
        "blocks with transactions are voted for without end",
        "            and not (node.block.transactions and len(branch) > UNFINALIZED_BLOCKS_MAX_COUNT)\n",
        "",
        "tests/unit/consensus/test_core_votes.py tests/unit/consensus/test_core_exhaustion.py",
    ),
    Replaced(
        Kind.VOTING,
        "consensus/protocol/voter.py",
        "who has begun a later epoch still speaks in this one",
        "        return self.index is not None and self.newest_epoch > self._epoch\n",
        "        return False\n",
        "tests/unit/consensus/test_core_returning.py",
    ),
    Replaced(
        Kind.VOTING,
        "consensus/protocol/voter.py",
        "a vote is sent before it is in the journal",
        (
            "        effects: list[Effect] = [Persist(records=(record,))]\n        if is_own:\n"
            "            effects.append(Broadcast(Proposal(block=node.block)))\n"
            "        effects.append(Broadcast(vote))\n        return vote, effects"
        ),
        (
            "        effects: list[Effect] = [Broadcast(vote), Persist(records=(record,))]\n"
            "        if is_own:\n            effects.append(Broadcast(Proposal(block=node.block)))\n"
            "        return vote, effects"
        ),
        "tests/unit/consensus/test_core_journal.py",
    ),
    Replaced(
        Kind.VOTING,
        "consensus/protocol/voter.py",
        "a timeout is sent before it is in the journal",
        "[Persist(records=(record,)), Broadcast(timeout)]",
        "[Broadcast(timeout), Persist(records=(record,))]",
        "tests/unit/consensus/test_core_journal.py",
    ),
    Replaced(
        Kind.VOTING,
        "consensus/chain/block_rules.py",
        "a round is skipped without a quorum that gave it up",
        "return tc is not None and tc.round == header.round - 1 and",
        "return tc is not None and",
        "tests/unit/consensus/test_core_votes.py",
    ),
    Replaced(
        Kind.VOTING,
        "consensus/chain/block_rules.py",
        "a block leaves the locked branch behind",
        "tc.round == header.round - 1 and header.qc.round >= tc.highest_qc_round",
        "tc.round == header.round - 1",
        "tests/unit/consensus/test_core_votes.py",
    ),
    Replaced(
        Kind.VOTING,
        "consensus/chain/block_rules.py",
        "time stands still from a block to the next",
        "header.timestamp_ms > parent.timestamp_ms",
        "header.timestamp_ms >= parent.timestamp_ms",
        "tests/unit/consensus/test_core_blocks.py",
    ),
    Replaced(
        Kind.VOTING,
        "consensus/chain/block_rules.py",
        "a block need not be signed by its leader",
        (
            '    _require(check(producer_key, PROPOSAL_TAG, block.signature, *parts), "The block is '
            'not signed by its producer.")\n'
        ),
        "",
        "tests/unit/consensus/test_core_blocks.py",
    ),
    Replaced(
        Kind.VOTING,
        "consensus/protocol/block_tree.py",
        "uncertified blocks of one round fill the tree",
        ("return block_id in self.certificates or self._first_of_round.get(header.round, block_id) == block_id"),
        "return True",
        "tests/unit/consensus/test_core_exhaustion.py tests/unit/consensus/test_core_blocks.py",
    ),
    Replaced(
        Kind.VOTING,
        "consensus/chain/message_checks.py",
        "a timeout may know of a certificate of its own round",
        "if not 0 <= timeout.qc.round < timeout.round < ROUND_MAX:",
        "if not 0 <= timeout.qc.round <= timeout.round < ROUND_MAX:",
        "tests/unit/consensus/test_core_timeouts.py",
    ),
    Replaced(
        Kind.VOTING,
        "contracts/system/membership.py",
        "half of the organisations decide",
        "len(good_voices(proposal)) < len(active_organisations()) // 2 + 1",
        "len(good_voices(proposal)) < len(active_organisations()) // 2",
        "tests/unit/contracts/system/test_membership.py",
    ),
    Replaced(
        Kind.VOTING,
        "contracts/system/membership.py",
        "a voice counts that was given with other keys",
        "    return [name for name in voices if numbers[name] == keys_number(name)]\n",
        "    return voices\n",
        "tests/unit/contracts/system/test_membership.py",
    ),
    Replaced(
        Kind.VOTING,
        "contracts/system/membership.py",
        "an expired proposal is still decided",
        'ctx.time < proposal["expires_ms"], "PROPOSAL_EXPIRED"',
        'True, "PROPOSAL_EXPIRED"',
        "tests/unit/contracts/system/test_membership.py",
    ),
    Replaced(
        Kind.VOTING,
        "contracts/system/producers.py",
        "half of the organisations seat a producer",
        "    return len(names) > len(organisations) // 2\n",
        "    return len(names) >= len(organisations) // 2\n",
        "tests/unit/contracts/system/test_producers.py",
    ),
    Replaced(
        Kind.VOTING,
        "contracts/system/producers.py",
        "a candidate that is not ready gets a seat",
        ' and is_majority(entry["votes"], organisations) and is_ready(entry)',
        ' and is_majority(entry["votes"], organisations)',
        "tests/unit/contracts/system/test_producers.py",
    ),
    Replaced(
        Kind.JOURNAL,
        "node/consensus/engine.py",
        "messages leave before the journal is synced",
        "            self._recorder.sync()\n            self._recorder.settle()",
        "            self._recorder.settle()",
        "tests/unit/node/test_engine.py",
    ),
    Replaced(
        Kind.JOURNAL,
        "node/consensus/journal.py",
        "a lost record is taken for a torn tail",
        "    if synced >= expected:\n",
        "    if False:\n",
        "tests/unit/node/test_journal.py",
    ),
    Replaced(
        Kind.JOURNAL,
        "node/consensus/journal.py",
        "a new file is put in place before it is synced",
        "        file.append(data)\n        file.sync()\n    except",
        "        file.append(data)\n    except",
        "tests/unit/node/test_journal.py tests/unit/node/test_journal_recovery.py",
    ),
    Replaced(
        Kind.JOURNAL,
        "node/consensus/journal.py",
        "a replaced file's folder is not synced",
        "    disk.replace(_aside(path), path)\n    disk.sync_directory(path.parent)\n",
        "    disk.replace(_aside(path), path)\n",
        "tests/unit/node/test_journal.py tests/unit/node/test_journal_recovery.py",
    ),
    Replaced(
        Kind.JOURNAL,
        "node/consensus/journal.py",
        "a journal goes on after a failed write",
        (
            "                except OSError as error:\n                    self._broken = True\n"
            "                    raise"
        ),
        "                except OSError as error:\n                    raise",
        "tests/unit/node/test_journal.py",
    ),
    Replaced(
        Kind.JOURNAL,
        "node/consensus/journal.py",
        "what waits to be written is lost by a compaction",
        "                records = [*keep, *((entry.kind, entry.record) for entry in carried)]\n",
        (
            "                records = [*keep, *((entry.kind, entry.record) for entry in written if "
            "entry.sequence > last)]\n"
        ),
        "tests/unit/node/test_journal.py",
    ),
    Replaced(
        Kind.JOURNAL,
        "node/consensus/journal.py",
        "a frame of another journal is read as its own",
        "zlib.crc32(record, zlib.crc32(covered, zlib.crc32(identity))) != checksum",
        'zlib.crc32(record, zlib.crc32(covered, zlib.crc32(b""))) != checksum',
        "tests/unit/node/test_journal.py",
    ),
    Replaced(
        Kind.JOURNAL,
        "node/consensus/journal_writer.py",
        "a refused sync is not noticed",
        "        if self._refusal:\n            self._begin_outage(self._refusal)\n",
        '        self._refusal = ""\n',
        "tests/unit/node/test_recording.py",
    ),
    Replaced(
        Kind.JOURNAL,
        "node/consensus/engine.py",
        "words are sent while the disk refuses",
        "            while self._waiting is None and not self._outages:\n",
        "            while self._waiting is None:\n",
        "tests/unit/node/test_recording.py tests/unit/node/test_engine.py",
    ),
)
