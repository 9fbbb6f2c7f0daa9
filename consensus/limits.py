"""Consensus-wide limits, with units in their names."""

from __future__ import annotations

# Units
MIB_BYTES = 1024 * 1024
DAY_MS = 86_400_000

# Transactions
TRANSACTION_SIZE_MAX_BYTES = 16 * 1024
TRANSACTION_LIFETIME_MAX_MS = 10 * 60 * 1000
CONTRACT_NAME_MAX_CHARS = 32

# Blocks
BLOCK_TRANSACTIONS_MAX_COUNT = 256
BLOCK_SIZE_MAX_BYTES = 1024 * 1024
BLOCK_GAS_MAX = 500_000
CALL_GAS_MAX = 250_000
UNFINALIZED_BLOCKS_MAX_COUNT = 64
PRODUCERS_MAX_COUNT = 21

# State
STATE_KEY_MAX_BYTES = 128
STATE_VALUE_MAX_BYTES = 16 * 1024

# Records
VISIT_MAX_MS = 10 * 60 * 1000
TIME_BUCKET_MS = 5 * 60 * 1000
RETENTION_DEFAULT_MS = 30 * 24 * 3600 * 1000
RETENTION_MAX_MS = 366 * 24 * 3600 * 1000
CLIP_FRAMES_MAX_COUNT = 64
RECORDS_A_CALL_MAX_COUNT = 64
CIPHERTEXT_MAX_BYTES = 1024 * 1024
CLIP_SIZE_MAX_BYTES = 16 * 1024 * 1024
SEALED_METADATA_BYTES = 560
# Empty frames that are approved for one robot at once, of up to 4 MiB each.
EMPTY_FRAMES_MAX_COUNT = 128
EMPTY_FRAMES_A_CALL_MAX_COUNT = 32
# Patients and operators are told by one measure that a custodian's receipt for an erasure is late.
ERASURE_OVERDUE_AFTER_MS = 120_000

# So long after the end of a grant its key may still read what became of the records, and say that copies are gone.
GRANT_NOTICE_MS = 90 * 24 * 3600 * 1000
GRANTS_OPEN_MAX_COUNT = 64

# Consensus core
TREE_BLOCKS_MAX_COUNT = 4096
ORPHAN_BLOCKS_MAX_COUNT = 256
VOTE_ROUNDS_AHEAD_MAX_COUNT = 64
UNSTORED_BLOCKS_MAX_COUNT = 4096
UNEXECUTED_BLOCKS_MAX_COUNT = 128
# A certified block that could not be executed is executed again after so long, twice as long each time.
EXECUTION_RETRY_MIN_MS = 250
EXECUTION_RETRY_MAX_MS = 30_000
SIGNATURE_CACHE_MAX_COUNT = 8192
EVIDENCE_ROUNDS_KEPT_COUNT = 64
WORD_CHECKS_MAX_COUNT = 8
