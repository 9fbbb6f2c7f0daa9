"""The one catalogue of errors: code, HTTP status, meaning, next step, and whether trying again can help.

Every refusal anywhere in BlockRobot raises `BlockRobotError` with a code from here, so that a log line, an HTTP
problem document and a line on a terminal say the same thing.
"""

from __future__ import annotations

from dataclasses import dataclass

from consensus.contract_refusals import find_next_step


@dataclass(frozen=True, slots=True)
class ErrorEntry:
    """One row of the catalogue. `status` is the HTTP status code (RFC 9110) used when the API reports it."""

    code: str
    status: int
    meaning: str
    next_step: str
    retryable: bool = False


def _table(*rows: ErrorEntry) -> dict[str, ErrorEntry]:
    table = {row.code: row for row in rows}
    if len(table) != len(rows):
        raise AssertionError("an error code is listed twice")
    return table


CATALOGUE: dict[str, ErrorEntry] = _table(
    # Encoding and signatures
    ErrorEntry("ENCODING_INVALID", 400, "The bytes are not a valid message of the expected type.", "Build it with the BlockRobot client library of the same version."),
    ErrorEntry("ENCODING_NOT_CANONICAL", 400, "The bytes decode, but not from their one canonical form.", "Encode again with fields in order and the shortest integers."),
    ErrorEntry("VALUE_INVALID", 400, "A value is of a type or size the ledger does not store.", "Use None, bool, int below 2^256, str, bytes, list or dict."),
    ErrorEntry("SIGNATURE_INVALID", 400, "The signature was not made by the stated key over these bytes.", "Sign again with the key named in the message; if a whole network refuses it, compare its genesis file with yours."),
    ErrorEntry("SIGNATURE_HIGH_S", 400, "The signature's s value is in the upper half; only the low form is accepted.", "Normalise s to the lower half of the curve order."),
    ErrorEntry("KEY_INVALID", 400, "The bytes are not a valid key.", "Check that the key was copied whole."),
    ErrorEntry("PROOF_INVALID", 400, "A proof does not lead to the root it is for.", "Ask another node; this one is damaged or dishonest."),
    ErrorEntry("PROOF_STALE", 409, "A proof is about an older block than this client has already seen.", "Ask again in a moment, or ask another node.", retryable=True),
    ErrorEntry("QUORUM_UNHEARD", 503, "Too few producers answered to know that nothing newer is final.", "Check `blockrobot status` and your connection to the nodes, then try again.", retryable=True),
    ErrorEntry("PROOF_OTHER_EPOCH", 409, "A proof is about an epoch that this client has not entered.", "Fetch `/v1/epochs?after=N`, follow the epochs, then ask again.", retryable=True),
    ErrorEntry("CERTIFICATE_INVALID", 400, "A certificate is not signed by a quorum of the producers.", "Ask another node; this one is damaged or dishonest."),
    ErrorEntry("BLOCK_INVALID", 400, "The block breaks a rule of the protocol.", "Ask another node; this one is damaged or dishonest."),
    ErrorEntry("GENESIS_INVALID", 400, "The genesis file is damaged or its parts contradict each other.", "Get the genesis file again from your organisation."),
    # Pages for one person on this machine
    ErrorEntry("PAGE_LINK_INVALID", 401, "The link that opened this page has been used, has expired, or is not one of this page's.", "A page that was reloaded, or opened twice, needs a new link: press Enter in the terminal where its command runs; if that has ended, run it again."),
    ErrorEntry("PAGE_SESSION_REQUIRED", 401, "This page has no session, or its session has ended.", "Open the page by a new link: press Enter in the terminal where its command runs; if that has ended, run it again."),
    ErrorEntry("PAGE_ORIGIN_REFUSED", 403, "The request does not come from this page itself.", "Open the page by the link that the command made, not by another name or from another page."),
    # Transactions
    ErrorEntry("TRANSACTION_TOO_LARGE", 413, "The transaction is larger than the chain allows.", "Split it into smaller transactions."),
    ErrorEntry("TRANSACTION_WRONG_CHAIN", 400, "The transaction was signed for another chain.", "Use the genesis file of the network you send it to."),
    ErrorEntry("TRANSACTION_EXPIRED", 400, "The transaction's valid_until lies in the past.", "Sign it again with a later valid_until."),
    ErrorEntry("TRANSACTION_TOO_FAR_AHEAD", 400, "valid_until is more than ten minutes ahead.", "Choose a valid_until within ten minutes; check your clock."),
    ErrorEntry("TRANSACTION_REPLAYED", 409, "This transaction is already known.", "Nothing to do: look it up by its txid."),
    ErrorEntry("TRANSACTION_CONTRACT_UNKNOWN", 404, "There is no such contract or entry.", "See what there is with `blockrobot contract list` and `blockrobot contract show NAME --abi`."),
    ErrorEntry("CALL_REFUSED", 409, "The contract refused the call.", "The sentence is the contract's own; `blockrobot contract show NAME --abi` shows what its entries take."),
    ErrorEntry("CONTRACT_NOT_FOUND", 404, "The chain has no such contract, or no such version of it.", "See what it has with `blockrobot contract list`; `blockrobot contract show NAME` names the versions."),
    ErrorEntry("CONTRACT_DISABLED", 409, "The organisations have disabled this contract.", "Wait until they activate a version again; `blockrobot contract show NAME` says since when it rests.", retryable=True),
    ErrorEntry("CONTRACT_CALL_OUTDATED", 409, "The version of the contract that is in force does not take this call.", "Use a client for that version; `blockrobot contract show NAME --abi` shows its entries, `blockrobot contract diff NAME` what changed."),
    ErrorEntry("SENDER_NOT_ADMITTED", 403, "Nobody who is admitted signed this: the sender is no member, no owner of a finalized visit and holds no voucher, or the signature is not the sender's.", "Register first, with the code on your card; if you did, sign again with the key that is registered."),
    ErrorEntry("MEMPOOL_FULL", 503, "The node holds as many waiting transactions as it may.", "Try again in a few seconds.", retryable=True),
    ErrorEntry("SENDER_LIMIT", 429, "This sender has too many transactions waiting.", "Wait until some are final.", retryable=True),
    ErrorEntry("PURPOSE_UNKNOWN", 400, "The network publishes no such purpose.", "Choose one of those that the sentence names."),
    ErrorEntry("SENSOR_UNKNOWN", 400, "There is no such sensor.", "Choose one of those that the sentence names."),
    ErrorEntry("ERASURE_NOT_CONFIRMED", 504, "The erasure is asked for, and not confirmed by all custodians yet.", "Nothing has to be asked again: custodians go on by themselves. See who has confirmed with `blockrobot wallet erasures`.", retryable=True),
    ErrorEntry("TRANSACTION_NOT_FINAL_IN_TIME", 504, "The transaction was not final within the time given.", "It may still become final: wait ten minutes, see whether it did (`blockrobot wallet audit`, `blockrobot contract trace TXID`), and only then do it again. If nothing becomes final: `blockrobot doctor`.", retryable=True),
    # Governance
    ErrorEntry("GOVERNANCE_NOT_ADMIN", 403, "Only an admin of an active organisation may do that.", "Sign with the key of an admin who may: --as ORGANISATION; `blockrobot org list` shows the organisations."),
    ErrorEntry("GOVERNANCE_APPROVED_ALREADY", 409, "The organisation has said so already; each has one voice.", "Let an admin of another organisation approve."),
    ErrorEntry("GOVERNANCE_PROPOSAL_CLOSED", 404, "There is no open proposal with this id.", "List the open ones with `blockrobot org list`, `settings list` and `contract list`, or propose it anew."),
    ErrorEntry("GOVERNANCE_WOULD_STOP_CHAIN", 409, "The change would leave the network without what it cannot do without.", "Add what is to take its place first."),
    ErrorEntry("GOVERNANCE_QUORUM_UNWELL", 409, "Too few of the producers that would be left are well: nothing could become final any more.", "Start or mend the nodes it names first (`blockrobot status`); with --anyway it is done all the same."),
    ErrorEntry("GOVERNANCE_SETTING_REFUSED", 409, "The setting does not exist or does not take this value.", "See names, values and ranges with `blockrobot settings list`."),
    ErrorEntry("GOVERNANCE_CONTRACT_REFUSED", 409, "The contract lifecycle refused the change of a contract.", "Compare with `blockrobot contract list` and `blockrobot contract show NAME`, and mend what the message names."),
    ErrorEntry("GOVERNANCE_PROPOSALS_TOO_MANY", 409, "The organisation has as many open proposals, or uploads that they need, as it may.", "Take one back with the command that the message names, or let one be decided first."),
    ErrorEntry("CONTRACT_CHANGE_FAILED", 409, "The decided change of a contract could not take effect; the version before answers on.", "Mend the source and propose it anew; `blockrobot contract show NAME` keeps what was wrong."),
    ErrorEntry("GOVERNANCE_REFUSED", 409, "The contracts that govern the network refused the change.", "Compare with `blockrobot org list` and `blockrobot producer list`, and mend what the message names."),
    ErrorEntry("ORGANISATION_KEY_NOT_FOUND", 404, "There is no key of this organisation here.", "Name an organisation whose folder lies in the network's folder, or its key file with --key."),
    ErrorEntry("GOVERNANCE_PROPOSED_ALREADY", 409, "The same change is proposed already, and open.", "Do not propose it again: approve the open one with the command that the message names."),
    ErrorEntry("AUTHORITY_UNFIT", 409, "The certificate is not one that could be this organisation's authority.", "Name the CA certificate of that organisation's own authority, such as its ca.crt.pem."),
    ErrorEntry("ORGANISATION_EXISTS", 409, "The folder of an organisation of this name is here already.", "Choose another name, or propose the one that is there: `blockrobot org propose add-org NAME --as ORG`."),
    ErrorEntry("SERIAL_INVALID", 400, "The text is no certificate's serial number.", "Copy the number from `blockrobot certificate list`: up to 40 hexadecimal digits."),
    # API and sessions
    ErrorEntry("REQUEST_INVALID", 400, "The request does not have the described form.", "See /v1/openapi.json for the form."),
    ErrorEntry("REQUEST_TOO_LARGE", 413, "The request body is larger than this route takes.", "Send less at once."),
    ErrorEntry("REQUEST_TIMEOUT", 408, "The request's body did not arrive in time.", "Send it again; check the connection.", retryable=True),
    ErrorEntry("MEDIA_TYPE_UNSUPPORTED", 415, "The route does not take a body of this media type or content encoding.", "Send the Content-Type that /v1/openapi.json names, uncompressed."),
    ErrorEntry("ROUTE_UNKNOWN", 404, "There is no such route.", "See /v1/openapi.json for the routes."),
    ErrorEntry("METHOD_NOT_ALLOWED", 405, "The route does not take this method.", "See /v1/openapi.json for the methods."),
    ErrorEntry("RATE_LIMITED", 429, "Too many requests from here.", "Wait a moment and try again.", retryable=True),
    ErrorEntry("SESSION_REQUIRED", 401, "This route is for members and owners with a session.", "Open a session by signing a challenge."),
    ErrorEntry("SESSION_EXPIRED", 401, "The session is over or was never opened on this node.", "Open a new session.", retryable=True),
    ErrorEntry("CHALLENGE_INVALID", 401, "The challenge is unknown, used or too old.", "Ask for a new challenge.", retryable=True),
    ErrorEntry("SESSION_REFUSED", 403, "The key is neither a member nor the owner of a finalized visit.", "Register first, with the code on your card."),
    ErrorEntry("MEMBER_NO_MORE", 403, "This wallet's words make nobody a member any more: other words were put in their place, or the membership ended.", "If you changed the words on another device, restore this wallet there or here with the new words and --former; if you did not, go to the registrar's desk at once and have the card revoked."),
    ErrorEntry("WALLET_ROTATION_OPEN", 409, "The wallet has new words that are not yet in force everywhere.", "Run `blockrobot wallet rotate` again: it goes on where it was cut off."),
    ErrorEntry("NOT_PERMITTED", 403, "This key may not do that.", "Use the key that the resource belongs to."),
    ErrorEntry("NOT_FOUND", 404, "There is no such thing here.", "Check the name, number or path that you gave."),
    ErrorEntry("NODE_NOT_READY", 503, "The node is starting or has lost its peers.", "Wait until /readyz answers 200.", retryable=True),
    ErrorEntry("NODE_UNREACHABLE", 503, "No node of the network answered.", "Check `blockrobot status`; start the network with `blockrobot up`.", retryable=True),
    ErrorEntry("INTERNAL", 500, "The node met a fault of its own; it is logged there.", "Try another node and report the fault.", retryable=True),
    # Nodes and storage
    ErrorEntry("DATA_DIRECTORY_IN_USE", 409, "Another process already runs on this data directory.", "Stop it first, or choose another directory."),
    ErrorEntry("DATA_DIRECTORY_INVALID", 400, "The directory does not hold a node that this version can open.", "Make one with `blockrobot node init`, or name the right directory."),
    ErrorEntry("PORT_IN_USE", 409, "Another program already listens on this port.", "Stop that program or choose other ports with --base-port."),
    ErrorEntry("STORAGE_DAMAGED", 500, "The node's storage is damaged.", "Stop the node, keep the directory for inspection, and make the node anew."),
    ErrorEntry("STORAGE_BUSY", 503, "Too many readers or writers use the node's storage at once.", "Try again in a moment.", retryable=True),
    ErrorEntry("STORAGE_FULL", 507, "The disk or the size allowed for the node's storage is used up.", "Free space on the disk or allow a larger store, then restart the node."),
    ErrorEntry("STORAGE_UNWRITABLE", 500, "The node's storage takes no more writes.", "Look at the disk and the log, then restart the node."),
    ErrorEntry("CONTRACT_WORKER_FAILED", 500, "The process that runs contracts could not do its work.", "Look at the node's log: it says how the process ended; `blockrobot doctor` says what its wall lacks.", retryable=True),
    ErrorEntry("CONTRACT_SANDBOX_INCOMPLETE", 500, "The system does not give a part of the wall around contracts that node.toml requires.", "Give the node what is named, or set `wall = \"on\"` in [contracts] of node.toml."),
    ErrorEntry("VIEWS_BUSY", 503, "As many views wait for this node's contract worker as may.", "Try again in a moment, or ask another node.", retryable=True),
    ErrorEntry("BLOCK_PRUNED", 410, "This node has dropped the bodies of blocks of that height.", "Ask the archive node that the message names. If it names none, ask the owner of the receipt: her wallet keeps its proof."),
    ErrorEntry("NODE_IS_ARCHIVE", 409, "The node is an archive: it keeps every block.", "Prune another node, or take `archive` out of its node.toml and start it again."),
    ErrorEntry("SNAPSHOT_DAMAGED", 400, "The snapshot's bytes are not those that its maker wrote.", "Copy it again, make a new one with `blockrobot node snapshot create`, or fetch it from another node."),
    ErrorEntry("SNAPSHOT_TRUNCATED", 400, "Parts of the snapshot are missing.", "Copy the whole folder again; what was cut off while it was made is no snapshot."),
    ErrorEntry("SNAPSHOT_VERSION", 400, "The snapshot has another format than this version reads.", "Make one with the version of BlockRobot that runs here."),
    ErrorEntry("SNAPSHOT_OTHER_CHAIN", 409, "The snapshot is of another chain than this node's genesis file.", "Use a snapshot of this network, or the genesis file that belongs to the snapshot."),
    ErrorEntry("SNAPSHOT_UNPROVEN", 400, "Nothing proves from the genesis file on that the snapshot's block is final.", "Take a snapshot from another node; this one is damaged or dishonest."),
    ErrorEntry("SNAPSHOT_OLD", 409, "The ledger here is as new as the snapshot, or newer.", "Nothing to do: start the node; it goes on from its own ledger."),
    ErrorEntry("JOURNAL_MISSING", 500, "The node's voting journal is not where it was made.", "Put the newest journal back; if it is lost, start the node once with `--restored`: it is then silent until the chain has gone on without it."),
    ErrorEntry("JOURNAL_UNWRITABLE", 500, "The voting journal cannot be written, so the node signs nothing.", "Make room on the disk; the node goes on by itself within seconds.", retryable=True),
    ErrorEntry("JOURNAL_DAMAGED", 500, "The voting journal is damaged in its middle.", "Keep a copy for inspection and start the node once with `--restored`: it is then silent until the chain has gone on without it."),
    ErrorEntry("CONFIGURATION_INVALID", 400, "The configuration is incomplete or contradicts itself.", "Compare it with the reference in docs/reference."),
    ErrorEntry("FILE_HOLDS_PRIVATE_KEY", 400, "A file that everybody would read holds a private key.", "Name a file with the certificates or public keys alone; keep the key where only its owner reads it."),
    ErrorEntry("USAGE_INVALID", 400, "A command was not called as it takes it.", "See how it is called: the same command with --help."),
    ErrorEntry("FILE_UNUSABLE", 400, "A file or folder cannot be read or written.", "Check its path, its permissions and the space on the disk."),
    ErrorEntry("FILE_EXISTS", 409, "A file that would be written is there already; nothing was written.", "Choose another name or another folder, or move away what is there."),
    ErrorEntry("EVENTS_STATE_OF_OTHERS", 409, "The state file remembers a place among other events.", "Ask with the --contract, --name and network that it names, or name another file with --state."),
    ErrorEntry("EVENTS_STATE_BROKEN", 400, "The file is no state file of `blockrobot contract events`, or it is damaged.", "Move it away, and go on with --from and the place of the last event that you have seen."),
    ErrorEntry("EVENTS_FILE_FOREIGN", 400, "Events would be added to a file that holds something else.", "Name another file with --out or --events; this one was left as it is."),
    ErrorEntry("EVIDENCE_INVALID", 400, "The evidence does not show two words of one producer.", "Accuse nobody of it; a node that made it is damaged or dishonest."),
    ErrorEntry("CLUSTER_NOT_RUNNING", 409, "No cluster runs in this directory.", "Start one with `blockrobot up`."),
    ErrorEntry("CLUSTER_ALREADY_RUNNING", 409, "A cluster already runs in this directory.", "Use it (`blockrobot console` shows it), or stop it with `blockrobot down`."),
    ErrorEntry("CLUSTER_START_FAILED", 500, "The cluster did not become ready in time.", "See `blockrobot logs` for the first error.", retryable=True),
    ErrorEntry("CLUSTER_FIRST_START_FAILED", 500, "The new network did not become ready in time, and was removed again.", "Mend what the last lines of its nodes name, then start it again.", retryable=True),
    ErrorEntry("FAULT_UNKNOWN", 400, "There is no such fault, behaviour, link profile or node.", "See `blockrobot fault --help` for the names."),
    ErrorEntry("FAULT_INVALID", 400, "A fault is described with a figure that makes no sense.", "Compare it with the examples in `blockrobot fault --help`."),
    ErrorEntry("FAULT_TARGET_ABSENT", 409, "The node is down, paused or starting, so that it cannot be told.", "See `blockrobot fault list`; resume or restart the node first.", retryable=True),
    ErrorEntry("FAULT_PLAN_INVALID", 400, "A line of the fault plan is wrong; nothing of it was done.", "Mend the line that is named; see docs/how-to/break-the-network.md."),
    ErrorEntry("FAULT_PLAN_RUNNING", 409, "A fault plan is being carried out already.", "Wait for its end or stop it on the console, then begin the next one.", retryable=True),
    ErrorEntry("FAULTS_DISABLED", 403, "The node takes no faults: its node.toml does not allow them.", "Use a network made by `blockrobot up`; no other should allow it."),
    ErrorEntry("OPERATOR_TOKEN_INVALID", 401, "The operator's token is missing or wrong.", "Send the token of the file operator.token in the node's data directory."),
    ErrorEntry("PEER_MESSAGE_INVALID", 400, "A peer sent bytes that are no message of the protocol.", "Check that all nodes run the same version."),
    ErrorEntry("PEER_UNAVAILABLE", 503, "The peer is not connected or did not answer in time.", "Wait until it is back; see `blockrobot status`.", retryable=True),
    ErrorEntry("PEER_REFUSED", 403, "The peer is no node of this network, or not the one that should be there.", "Check the peer's certificate, and `blockrobot org list` for the nodes of the network."),
    ErrorEntry("PEER_CERTIFICATE_FOREIGN", 403, "The certificate is not from the authority of the organisation that runs the node.", "Issue it with that organisation's authority: `blockrobot certificate issue`."),
    ErrorEntry("PEER_CERTIFICATE_EXPIRED", 403, "The peer's certificate is over, or does not count yet.", "On the peer's machine: `blockrobot certificate renew NODE`; check both clocks."),
    ErrorEntry("PEER_CERTIFICATE_REVOKED", 403, "The peer's organisation revoked this certificate.", "If the node is to go on, on its machine: `blockrobot certificate renew NODE --new-key`."),
    ErrorEntry("PEER_CUT_OFF", 403, "The peer sent what no honest node sends, and is not heard for a while.", "If it is not one of your experiments: look at that node's machine and program; if its key may be stolen, revoke the certificate: `blockrobot certificate renew NODE --new-key`.", retryable=True),
    ErrorEntry("PEER_SILENT", 403, "The peer shook hands and said no hello.", "If that node is well: its key may be stolen; revoke the certificate: `blockrobot certificate renew NODE --new-key`.", retryable=True),
    ErrorEntry("PEER_REMOVED", 403, "The node was removed from the network.", "Nothing to do, unless its organisation has it added again."),
    ErrorEntry("CERTIFICATE_EXPIRED", 503, "This node's certificate is over: no peer talks to it, it serves reads only.", "Renew it: `blockrobot certificate renew NODE`; the running node takes it at once."),
    ErrorEntry("CERTIFICATE_EXPIRES_SOON", 400, "This node's certificate ends within thirty days.", "Renew it: `blockrobot certificate renew NODE`; the running node takes it at once."),
    ErrorEntry("CERTIFICATE_REVOKED", 503, "This node's certificate was revoked: no peer talks to it, it serves reads only.", "Make a new one: `blockrobot certificate renew NODE --new-key`; the running node takes it at once."),
    ErrorEntry("AUTHORITY_NOT_HERE", 404, "The organisation's certificate authority is not on this machine.", "Run the command where its folder is, or name it with --authority."),
    ErrorEntry("NODE_EXISTS", 409, "There is a node of this name, or in this directory, already.", "Choose another name; a name is never used twice in one network."),
    ErrorEntry("NODE_REMOVED", 503, "The network decided to remove this node: no peer talks to it, it serves reads only.", "Stop it; its data directory can be kept or destroyed."),
    # Custody
    ErrorEntry("UPLOAD_HASH_MISMATCH", 400, "The uploaded bytes do not have the hash they claim.", "Upload again; the bytes were damaged on the way."),
    ErrorEntry("UPLOAD_CONFLICT", 409, "Another upload with this identifier is already there.", "Use a new random identifier."),
    ErrorEntry("UPLOAD_QUOTA_EXCEEDED", 429, "The robot, or its organisation's robots together, have brought as much as the network allows.", "Wait as long as Retry-After says; `blockrobot custody status` shows who brought how much, and organisations may change the quota with `blockrobot settings propose`.", retryable=True),
    ErrorEntry("DISK_RESERVE_REACHED", 503, "The custodian's disk is nearly full, so it takes no uploads; it still erases, votes and prunes.", "Give its disk more room, or see `[custody] reserve_mib` in node.toml.", retryable=True),
    ErrorEntry("VISIT_NOT_OPEN", 409, "The chain knows no open visit of this robot under the clip's owner key.", "Open the visit and wait until that is final, then upload.", retryable=True),
    ErrorEntry("EMPTY_FRAME_NOT_APPROVED", 403, "Nobody of the robot's organisation has approved the empty frame on the chain, or it was withdrawn.", "Look at the frames: is nobody in them? Then an admin says `blockrobot frames approve FOLDER`; on a network for trials the robot's own `--approve-as ORG` does it."),
    ErrorEntry("EMPTY_FRAME_WITHDRAWN", 404, "The empty frame was withdrawn: no robot may publish it any more.", "Nothing is to be done: what was recorded on it is shown without the room."),
    ErrorEntry("BACKGROUND_NOT_A_PICTURE", 400, "The empty frame is no depth picture: a greyscale PNG of 16 bits.", "Record it with `blockrobot robot background record`."),
    ErrorEntry("UPLOAD_INVALID", 400, "The upload is incomplete or too large.", "Build it with the robot client of the same version."),
    ErrorEntry("CLIP_NOT_CONFIRMED", 409, "The clip's record is not final yet.", "Try again in a second.", retryable=True),
    ErrorEntry("CLIP_ERASED", 410, "The clip was erased.", "Nothing to do: see the erasure receipts."),
    ErrorEntry("CUSTODY_OUT_OF_ORDER", 500, "The custodian was handed a block that does not follow its checkpoint.", "Hand in finalized blocks from the checkpoint on; if the chain is another one, begin with an empty store."),
    ErrorEntry("CUSTODY_CATCHING_UP", 503, "The custodian has not followed the chain far enough to say or serve anything yet.", "Try again in a moment; `blockrobot custody status` says how far it is.", retryable=True),
    ErrorEntry("CUSTODY_ELSEWHERE", 404, "This node keeps no clips.", "Ask a node that the genesis file names as a custodian."),
    ErrorEntry("ACCESS_NOT_GRANTED", 403, "There is no final access transaction of the owner for this record.", "Submit an access request and wait until it is final."),
    ErrorEntry("ACCESS_ENDED", 403, "What may be released of this visit was narrowed after this access request, which is void since.", "Ask again: `blockrobot wallet view` makes a new request, and says if it is refused."),
    ErrorEntry("CORRECTION_UNPROVEN", 409, "The chain holds no such correction of that visit: it was changed, or never said.", "Ask the person for the file that `blockrobot wallet correct --out` wrote."),
    ErrorEntry("GRANT_PARTS_MISSING", 409, "Fewer than two custodians have given their parts of the key under which these records were shared.", "Try again while more custodians can be reached; if it stays so, ask the person to share it once more.", retryable=True),
    ErrorEntry("GRANT_ENDED", 410, "What was shared is no longer: it was revoked, its time is over, or the record was erased.", "Ask the person to share it again if you still need it."),
    ErrorEntry("GRANTEE_NOT_A_MEMBER", 403, "Only an active member of the staff, or an officer, fetches what was shared, and only under the name that the grant hides.", "Open the share with the wallet for which it was made; an unenrolled member asks her registrar."),
    ErrorEntry("CLIP_QUARANTINED", 403, "The visit was denied by its owner, and nothing of it is released to anybody.", "Wait for the data protection officer's decision: `blockrobot wallet audit` shows it."),
    ErrorEntry("ERASE_KEYS_DAMAGED", 500, "The custodian's erase-key file is damaged.", "Stop the custodian and restore the file from its own backup medium."),
    ErrorEntry("STORE_UNAVAILABLE", 503, "The custodian's store does not answer.", "Check the store's server and its URI.", retryable=True),
    # Records, robot and wallet
    ErrorEntry("VOUCHER_INVALID", 400, "The enrolment code is damaged.", "Scan or type the code on the card again."),
    ErrorEntry("HANDLE_MISTYPED", 400, "The short handle has a wrong letter, or one too few or too many.", "Compare it letter by letter with what the other's `wallet handle` shows, or have it sent to you in a file: @FILE."),
    ErrorEntry("QR_UNREADABLE", 400, "There is no QR code in the picture that can be read.", "Photograph the whole code again, straight from above, sharp and with light; or type the letters below it."),
    ErrorEntry("VOUCHER_EXPIRED", 403, "The enrolment code is too old.", "Ask the registrar for a new card."),
    ErrorEntry("VOUCHER_FOREIGN", 403, "The enrolment code was not issued by a registrar of this network, or not to this holder.", "Check that the card and the genesis file are of the same network, and use your own card."),
    ErrorEntry("HANDLE_TAKEN", 409, "The enrolment code was used already.", "A wallet that you registered with it is restored from its words; a robot that was registered with it needs no other. Otherwise tell the registrar, who issues a new card."),
    ErrorEntry("ENVELOPE_INVALID", 400, "The sealed bytes do not open with this key.", "They were made for another person, or were changed."),
    ErrorEntry("RENDITION_CORRUPTED", 409, "The picture is not the one that the robot committed to.", "Tell the hospital: the custodian's copy was changed."),
    ErrorEntry("FRAMES_MISCOUNTED", 409, "The robot counted another number of pictures than it committed to.", "Ask the hospital's data protection officer why: the robot's own figures contradict each other, and no custodian can cause that."),
    ErrorEntry("BAG_DAMAGED", 400, "The recording cannot be read, or breaks off.", "If it breaks off, what stood before was used: check the file, or record it again. If it is no recording, name a ROS 1 .bag, a rosbag2 folder, or an .mcap or .db3 file."),
    ErrorEntry("EVENT_LOG_INVALID", 400, "The event log cannot be read.", "Name a log of `blockrobot robot --events` (JSON lines, CSV, XES) or one in the form that the prototype's authors published; see docs/how-to/run-the-experiments.md."),
    ErrorEntry("DRAWING_UNAVAILABLE", 501, "The process map could not be drawn with Graphviz.", "Install Graphviz (Debian: `apt install graphviz`), then `dot -Tsvg FILE.dot -o FILE.svg`: the DOT file is there."),
    ErrorEntry("RECORDING_TOO_LARGE", 413, "The recording is larger, once it is unpacked, than there is room for.", "Unpack it yourself (`zstd -d`) where there is room, take `compression_mode` out of its metadata.yaml, and name that folder; or set TMPDIR to a disk with room."),
    ErrorEntry("BAG_TOPIC_MISSING", 400, "The recording lacks a topic that the robot needs.", "See what it has with `blockrobot robot topics RECORDING`; name the topics with --depth and --tags, or in a file given with --topics."),
    ErrorEntry("TOPICS_INVALID", 400, "The topics that were named contradict themselves or the recording.", "Compare the file with docs/reference/topics-toml.md; `blockrobot robot topics RECORDING --draft FILE` writes one to start from."),
    ErrorEntry("EMPTY_SCENE_MISSING", 400, "There are no frames of the scene without people.", "Choose some with --empty-seconds A..B, --empty-topic TOPIC or --empty RECORDING; live, record a viewpoint of the robot first with `blockrobot robot background record --source ...`."),
    ErrorEntry("CAMERA_SILENT", 503, "The robot's camera sent no frame that can be used.", "See what there is with `blockrobot robot topics --source ...`; name the camera's topic with --depth TOPIC or in the topics file.", retryable=True),
    ErrorEntry("MIDDLEWARE_MISSING", 501, "The library of the robot's middleware is not installed where BlockRobot runs.", "Install it as the message says; docs/how-to/your-robot.md has more."),
    ErrorEntry("FEED_UNREACHABLE", 503, "The robot's middleware, or a reader, does not answer.", "Start it, check the address that the message names, and run the command again.", retryable=True),
    ErrorEntry("FEED_LOST", 503, "The robot's middleware, or a reader, is gone for good.", "What came before is recorded; see what ended it, and start the robot again.", retryable=True),
    ErrorEntry("FRAMES_UNUSABLE", 400, "Too many messages in a row could not be used.", "See the reasons in the run's summary; check the camera's and the reader's settings."),
    ErrorEntry("BACKGROUND_NOT_FOUND", 404, "There are no empty frames of this viewpoint.", "Record some with `blockrobot robot background record RECORDING --viewpoint NAME`, or see `blockrobot robot background list`."),
    ErrorEntry("BACKGROUND_PREVIEW_DIFFERS", 409, "The preview beside the empty frames does not show them as they are now.", "Give the command without --yes: it draws the preview anew, from the very frames that it would approve."),
    ErrorEntry("BACKGROUND_INVALID", 400, "The empty frames cannot be used.", "Record some seconds with nobody in the picture and nothing that moves; of a recording, choose others with --empty-seconds A..B."),
    ErrorEntry("BACKGROUND_NOT_APPROVED", 403, "Nobody has approved the empty frames of this viewpoint as they are.", "Look at their preview, then `blockrobot robot background approve NAME --by PERSON`."),
    ErrorEntry("BACKGROUND_EXPIRED", 403, "The approval of this viewpoint's empty frames is over.", "Record the empty scene anew, or approve what there is again."),
    ErrorEntry("EXTRA_MISSING", 501, "This needs a package that is not installed.", "In your clone of BlockRobot, run the `make install-...` that the message names, e.g. `make install-attack`."),
    ErrorEntry("FRAME_INVALID", 400, "The frame's size, encoding or step is not what it says.", "Check the camera driver's settings."),
    ErrorEntry("FRAME_TIME_WRONG", 400, "The frame's stamp is too far from the time of the stream.", "Set the camera's clock, or have its driver stamp frames with the host's time."),
    ErrorEntry("PAIRING_FULL", 503, "Too many frames wait to be paired.", "Check that the camera's stamps go on: frames of one and the same time wait for ever.", retryable=True),
    ErrorEntry("ROSTER_INVALID", 400, "The roster cannot be opened or its signature is wrong.", "Ask the registrar for this robot's roster of today."),
    ErrorEntry("ROSTER_EXPIRED", 403, "The roster is older than a day.", "Ask the registrar for this robot's roster of today."),
    ErrorEntry("REGISTRY_STALE", 503, "The network proves no recent block, or this robot's clock is wrong.", "Wait for the network to make a block and begin again; check the robot's clock.", retryable=True),
    ErrorEntry("ROBOT_EXISTS", 409, "There is already a robot at this place.", "Use it, or choose another --name."),
    ErrorEntry("ROBOT_RUNNING", 409, "Another process runs this robot.", "Wait for it, end it, or name another robot with --name."),
    ErrorEntry("ROBOT_PASSPHRASE_MISSING", 403, "The robot's key file is sealed under a passphrase.", "Name a file that holds it: `blockrobot robot --passphrase-file FILE ...`, or start at a terminal and type it."),
    ErrorEntry("ROBOT_PASSPHRASE_WRONG", 403, "The passphrase does not open the robot's key file.", "Try again; if it is lost, have the robot revoked at the desk (`blockrobot card revoke`) and make a new one."),
    ErrorEntry("ROBOT_NOT_FOUND", 404, "There is no robot at this place.", "Make one with `blockrobot robot new`, or name the right one with --name."),
    ErrorEntry("FOLDER_NOT_EMPTY", 409, "The folder holds something that this command did not make.", "Name a folder that does not exist yet."),
    ErrorEntry("SPOOL_FULL", 507, "The robot's spool is full.", "Reconnect the robot to the network.", retryable=True),
    ErrorEntry("SPOOL_DAMAGED", 500, "The robot's spool is damaged.", "Keep the directory for inspection and start with a new one."),
    ErrorEntry("WALLET_EXISTS", 409, "There is already a wallet at this place.", "It is left as it is: make or bring back another one beside it under another name, with --profile NAME."),
    ErrorEntry("KEYRING_EMPTY", 404, "The system's keyring holds no passphrase of this wallet.", "Put it there with `blockrobot wallet keyring store`, or leave out --keyring."),
    ErrorEntry("KEYRING_UNUSABLE", 503, "The system's keyring cannot be used here.", "If it is locked, unlock it; else name another with PYTHON_KEYRING_BACKEND, or do without: leave out --keyring and type the passphrase."),
    ErrorEntry("WALLET_NOT_FOUND", 404, "There is no wallet at this place.", "Make one with `blockrobot wallet new`, or get yours back from its 24 words with `blockrobot wallet restore`, or from your guardians' words with `blockrobot wallet guardians recover`."),
    ErrorEntry("WALLET_PASSPHRASE_WRONG", 403, "The passphrase does not open this wallet.", "Try again, or restore the wallet from its 24 words."),
    ErrorEntry("PASSPHRASE_WEAK", 403, "The passphrase is too easy to guess: whoever copies the wallet's file can try as many as he likes.", "Choose a longer one, of 15 letters or more: four or five words that come to nobody else's mind are good."),
    ErrorEntry("PASSPHRASE_UNCONFIRMED", 400, "The passphrase was typed differently the second time.", "Begin again, and type the same twice."),
    ErrorEntry("WORDS_NOT_CHECKED", 409, "The words that were typed are not those that were shown.", "Run the command again when you can write them down."),
    ErrorEntry("WALLET_BUSY", 409, "Another program has this wallet open.", "If it is `blockrobot wallet serve`: press Enter in the terminal where it runs for a new link to its page, or Ctrl-C to end it. Otherwise wait until the other command has ended; then try again.", retryable=True),
    ErrorEntry("PASSPHRASE_LOCKED", 429, "The passphrase was wrong too often.", "Wait as long as the sentence says, then try again.", retryable=True),
    ErrorEntry("CLIP_NOT_OPEN", 409, "This recording is not open any more.", "Open it again."),
    ErrorEntry("JOB_NOT_STOPPABLE", 409, "This cannot be stopped: it may stand on the ledger already.", "Wait until it is done."),
    ErrorEntry("NOTICE_NOT_SHOWN", 409, "What your organisation tells you was not shown to you in the version that is in force.", "Read it, then say it again."),
    ErrorEntry("WALLET_DAMAGED", 500, "The wallet file is damaged.", "Restore the wallet from its 24 words."),
    ErrorEntry("WORDS_INVALID", 400, "The words are not a valid recovery phrase.", "Check spelling and order of the 24 words."),
    ErrorEntry("SHEETS_FOLDER_USED", 409, "The folder holds sheets already: those of two sets must not lie together, and nobody could tell them apart.", "Choose a new folder: --out FOLDER."),
    ErrorEntry("SHARE_WORD_UNKNOWN", 400, "One of these words is on no guardian's sheet.", "Compare that word with the sheet, letter by letter."),
    ErrorEntry("SHARE_INVALID", 400, "These words are no guardian's words: one is missing, wrong or in the wrong place.", "Compare them with the sheet, word by word, with their numbers."),
    ErrorEntry("SHARE_OF_ANOTHER_SPLIT", 409, "These guardian's words belong to another set than those before.", "Use sheets with the same set number only; a wallet can have been shared out several times."),
    ErrorEntry("SHARE_REPEATED", 409, "The words of this guardian are here already.", "Take those of another guardian."),
    ErrorEntry("SHARES_TOO_FEW", 409, "There are too few guardians' words for this wallet.", "Ask another guardian: the sheet says how many are needed."),
    ErrorEntry("SHARES_CONTRADICT", 409, "These guardians' words do not lead to a wallet together: at least one of them is not what was handed out.", "Add the words of one more guardian: those that are wrong are left out."),
    ErrorEntry("WORDS_REPEATED", 400, "The same words are named twice.", "Give the words in force by --words-file, and each words that they replaced by --former, once."),
    ErrorEntry("WORDS_SWAPPED", 409, "Words that were named as former ones are in force, and the others are not.", "Restore the wallet the other way round: the words in force by --words-file, those that they replaced by --former."),
    ErrorEntry("BUNDLE_INVALID", 400, "The file is no export bundle, or it is damaged or was changed.", "Check the file as `blockrobot wallet export` wrote it: not unpacked and packed again, and copied whole."),
    ErrorEntry("BUNDLE_UNPROVEN", 409, "Something in the export bundle does not follow from its proofs.", "Believe nothing of this file; ask whoever gave it to you for the bundle as it was exported."),
    ErrorEntry("BUNDLE_OTHER_CHAIN", 409, "The export bundle is of another network than the one you named.", "Compare the network's name and its genesis file with whoever runs the network."),
    # What a person names by the beginning of its id
    ErrorEntry("NAME_TOO_SHORT", 400, "Too few characters were named to be sure which one is meant.", "Name eight characters or more, as the list that shows it has them."),
    ErrorEntry("NAME_AMBIGUOUS", 400, "Several fit what was named.", "Name more of its characters, or one of those that the sentence lists."),
    ErrorEntry("RECORD_NOT_FOUND", 404, "You have no such record.", "`blockrobot wallet records` shows what was recorded of you; what was shared with you shows `blockrobot wallet inbox`."),
    ErrorEntry("VISIT_NOT_FOUND", 404, "You have no such visit.", "`blockrobot wallet records` shows your visits."),
    ErrorEntry("GRANT_NOT_FOUND", 404, "There is no such share.", "What you share shows `blockrobot wallet shares`; what is shared with you, `blockrobot wallet inbox`."),
    ErrorEntry("BREACH_NOT_FOUND", 404, "There is no such breach.", "`blockrobot officer breaches --all` shows them."),
    ErrorEntry("PROPOSAL_NOT_FOUND", 404, "There is no such proposal.", "`blockrobot officer lost-keys list --all` shows what was proposed."),
    ErrorEntry("HANDLE_NOT_FOUND", 404, "Nobody is registered under this handle.", "Have the other read it out again: `wallet handle`."),
    ErrorEntry("MANDATE_NOT_FOUND", 404, "There is no such mandate.", "Yours shows `blockrobot wallet mandates list --all`; officers see all with `blockrobot officer mandates list --all`."),
    ErrorEntry("MANDATE_MISSING", 403, "You act for nobody of this handle now.", "`blockrobot wallet mandates list --all` shows for whom you act, and what you can accept; two officers give a mandate."),
    ErrorEntry("MANDATE_PAPERS_OTHER", 409, "These are not the papers that the mandate was proposed on.", "Have your colleague give you the receipt and every paper that it names; if they are others, end the proposal: `blockrobot officer mandates end`."),
    ErrorEntry("SPAN_INVALID", 400, "This is no span of time in which visits can be looked for.", "Name the minutes in which the visits began, an hour at most: --from \"2026-03-01 09:30\" --until \"2026-03-01 09:40\"."),
    ErrorEntry("SPAN_EMPTY", 404, "There is nothing of this in the span.", "Was it another minute, another day or another robot? Visits count by when they began: try `blockrobot officer lost-keys preview` with other minutes."),
    ErrorEntry("SPAN_TOO_FULL", 409, "More visits are in the span than may go.", "Make the span shorter: she may know the minute. Or let more go by --visits, 64 at most."),
    ErrorEntry("NOTHING_TO_CONFIRM", 404, "Nothing of this is to be confirmed.", "`blockrobot wallet inbox` shows what is to be deleted, and what you have confirmed."),
    ErrorEntry("NOTHING_TO_SHARE", 404, "There is nothing left of this to share.", "Erased records cannot be shared, nor pictures that no custodian has whole: `blockrobot wallet records` shows what is left."),
    ErrorEntry("SHARE_NOT_POSSIBLE", 400, "This cannot be shared so.", "See with whom, for what and for how long one can: `blockrobot wallet share --help`."),
    ErrorEntry("SHARE_WITH_NON_MEMBER", 403, "Records are shared with active members of the staff and with officers only.", "Name a member of the staff or an officer. If this is one, have them read their handle out again: `wallet handle`."),
    ErrorEntry("SHARE_CUSTODIANS_MISSING", 503, "Too few custodians took their parts of the key, so nothing was shared.", "Try again when they are back; `blockrobot status` shows who is away.", retryable=True),
    ErrorEntry("COPIES_REMAIN", 409, "Pictures that were shared are still on this machine.", "Delete them, or give --delete, and confirm then."),
    ErrorEntry("EXPORT_TOO_LARGE", 400, "The export would be larger than one bundle may be.", "Export it in parts: choose records with --records, --from and --until, or leave pictures out with --no-pictures."),
    ErrorEntry("NOTICE_INVALID", 422, "The privacy notice is damaged, or leaves out what people have to be told.", "Compare it with the form that `blockrobot notice new` writes, and check it with `blockrobot notice check FILE`."),
    ErrorEntry("NOTICE_NOT_FOUND", 404, "No privacy notice is published.", "An admin of the organisation publishes one with `blockrobot notice publish FILE`."),
    ErrorEntry("PURPOSE_NOT_TOLD", 409, "The privacy notice in force does not name this purpose, so nobody can know what she would agree to.", "Choose one that the sentence names (`blockrobot wallet notice` shows them); if another is wanted, the organisation has to publish a notice that names it first."),
    ErrorEntry("SENSOR_NOT_TOLD", 409, "The privacy notice in force does not name this sensor for this purpose, so nobody can know what she would agree to.", "Choose one of the sensors that the sentence names for it; if another is wanted, the organisation has to publish a notice that names it first."),
    ErrorEntry("CONSENT_NOT_ASKED", 409, "By the privacy notice in force this purpose does not rest on consent, so there is nothing to agree to.", "Read in the notice on what it rests (`blockrobot wallet notice`); `blockrobot wallet object` says that you do not want it."),
    ErrorEntry("CONSENT_RECEIPT_INVALID", 409, "A consent receipt is not what was said and proved on the chain.", "Keep it as evidence, do not sign it, and ask the data protection officer of the organisation; `blockrobot wallet consent list` shows what holds."),
    ErrorEntry("KEPT_PROOF_DAMAGED", 409, "A proof that the wallet keeps does not hold.", "Restore the wallet from a backup of its file; while a node keeps the block, `blockrobot wallet erasures` asks for the proof again."),
    ErrorEntry("RECEIPT_FILE_DAMAGED", 400, "The file is no file of consent receipts, or not as a wallet wrote it.", "Have the file copied again, whole. A wallet writes its own anew: `blockrobot wallet consent receipts --out FILE`."),
    ErrorEntry("CONSENT_WORD_MISSING", 404, "The transaction holds no word of consent.", "Name the transaction in which consent was given, refused or taken back; `blockrobot wallet consent receipts --search` finds all of yours."),
    ErrorEntry("CONSENT_RECEIPT_ELSEWHERE", 404, "This node signs no consent receipt for this person.", "Ask a custodian node of the organisation that registered the person."),
    ErrorEntry("NOT_REGISTERED", 409, "This wallet is not registered yet.", "Register with the code on your card: `blockrobot wallet register CODE`."),
    ErrorEntry("VECTORS_MISSING", 404, "There are no golden vectors in this folder.", "Name the folder of a source tree with `--from tests/vectors/contracts`."),
    ErrorEntry("CONTRACT_SOURCE_INVALID", 400, "The contract's source is not in the contract language.", "See the diagnostics: each has a line and a fix."),
    ErrorEntry("CONTRACT_ARGUMENTS_INVALID", 400, "The arguments do not fit what the entry takes.", "Give one argument for each parameter: numbers, text, bytes as 0x..., lists and objects as JSON; -- before the first if one begins with a minus."),
    ErrorEntry("CONTRACT_KIT_INCOMPLETE", 400, "Something that the author's kit needs is not installed.", "Install pytest beside BlockRobot: `make types` does, and so does its extra `kit`."),
)


class BlockRobotError(Exception):
    """A refusal with a code of the catalogue and a plain sentence of what happened this time.

    `detail` must be fit for users' eyes: no secrets, no stack traces.
    """

    def __init__(self, code: str, detail: str = "", **context: str | int) -> None:
        self.entry = CATALOGUE[code]
        self.code = code
        self.detail = detail or self.entry.meaning
        self.context = context
        super().__init__(f"{code}: {self.detail}")

    @property
    def next_step(self) -> str:
        """What the reader can do about it; of what a contract refused, by the contract's own code where that says more."""
        if self.code != "CALL_REFUSED":
            return self.entry.next_step
        return find_next_step(str(self.context.get("contract_code", "")), self.detail) or self.entry.next_step
