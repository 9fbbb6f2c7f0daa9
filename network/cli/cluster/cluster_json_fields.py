"""`--json` fields of local network commands: up, status, fault, console, explore, etc."""

from __future__ import annotations

from clients.sdk.terminal.json_fields import CommandAnswer, Field, Kind

_SILENT = "if the node is stopped, or does not answer"

_WHY = (
    Field("code", Kind.TEXT, "the error's code"),
    Field("detail", Kind.TEXT, "what happened"),
    Field("next_step", Kind.TEXT, "what to do"),
)
_REFUSALS = (
    Field("peer", Kind.TEXT, "the node"),
    *_WHY,
    Field("since_ms", Kind.TIME_MS, "since when, by its own clock"),
    Field("count", Kind.COUNT, "how often"),
)
_OVER_BUDGET = (Field("peer", Kind.TEXT, "who: a peer, an address, a member's key"), *_REFUSALS[1:])
_CUT_OFF = (
    *_REFUSALS[:-2],
    Field("count", Kind.COUNT, "how often since the node's start"),
    Field("until_ms", Kind.TIME_MS, "until when, by the node's own clock"),
)
_WORKER = (
    Field("pid", Kind.COUNT, "its process", null="if none was needed yet"),
    Field("replaced", Kind.COUNT, "how often it was replaced"),
    Field("last_loss", Kind.TEXT, "why it was replaced the last time; empty if it never was"),
    Field("missing", Kind.TEXTS_BY_NAME, "parts of the wall that this system has not, and why"),
)

BLOCKS_KEPT = (
    Field("archive", Kind.BOOL, "whether it keeps the bodies of all blocks"),
    Field("earliest_ms", Kind.TIME_MS, "the time of the oldest block whose body it has", null="if it cannot be read"),
    Field(
        "held_by",
        Kind.TEXT,
        "why older blocks than due are there: `keep_blocks`, `custodian` (has not followed them) or `record` (one under "
        "a claim)",
        null="if none are",
    ),
)
_STATUS = (
    Field("organisation", Kind.TEXT, "whose node it is", null="if the chain does not know it", absent=_SILENT),
    Field("membership", Kind.TEXT, "`active`, `removed` or `unknown`, by its own chain", absent=_SILENT),
    Field("directory_height", Kind.HEIGHT, "the block of its list of nodes", absent=_SILENT),
    Field("chain_id", Kind.HEX, "the network", absent=_SILENT),
    Field("ready", Kind.BOOL, "whether it is in touch with a quorum, not far behind, and can write", absent=_SILENT),
    Field("height", Kind.HEIGHT, "its newest certified block", absent=_SILENT),
    Field("finalized_height", Kind.HEIGHT, "its newest final block", absent=_SILENT),
    Field("earliest_height", Kind.HEIGHT, "the oldest block whose body it has", absent=_SILENT),
    Field(
        "blocks_kept",
        Kind.OBJECT,
        "how far back it keeps blocks",
        absent=_SILENT,
        fields=BLOCKS_KEPT,
    ),
    Field("state_root", Kind.HEX, "the root of its state", null="before its first block", absent=_SILENT),
    Field("state_height", Kind.HEIGHT, "the block of that root", null="before its first block", absent=_SILENT),
    Field("round", Kind.COUNT, "its consensus round", absent=_SILENT),
    Field("epoch", Kind.COUNT, "its epoch", absent=_SILENT),
    Field("leader", Kind.TEXT, "the node that leads the round", null="if its name is not known", absent=_SILENT),
    Field("peers", Kind.TEXTS, "names of the nodes that it is connected to", absent=_SILENT),
    Field("mempool", Kind.COUNT, "transactions that wait", absent=_SILENT),
    Field(
        "custody_checkpoint",
        Kind.HEIGHT,
        "the block that its custodian has followed to",
        null="if it is no custodian",
        absent=_SILENT,
    ),
    Field("fault", Kind.TEXT, "why it has stopped taking part", null="if it has not", absent=_SILENT),
    Field(
        "execution",
        Kind.OBJECT,
        "what it could not execute",
        absent=_SILENT,
        fields=(
            Field("held", Kind.COUNT, "transactions that it proposes in no block now"),
            Field("failures", Kind.COUNT, "executions that failed since its start"),
            Field("last_failure", Kind.TEXT, "why the last one failed; empty if none did"),
            Field(
                "stuck",
                Kind.OBJECT,
                "the block that others could execute and it cannot",
                null="if there is none",
                fields=(
                    Field("height", Kind.HEIGHT, "its height"),
                    Field("attempts", Kind.COUNT, "how often it was tried"),
                ),
            ),
        ),
    ),
    Field(
        "silent",
        Kind.OBJECT,
        "why it signs nothing",
        null="if it may sign",
        absent=_SILENT,
        fields=(Field("reason", Kind.TEXT, "why"), Field("until", Kind.TEXT, "until when")),
    ),
    Field(
        "finality",
        Kind.OBJECT,
        "whether blocks become final in time",
        absent=_SILENT,
        fields=(
            Field("age_s", Kind.SECONDS, "since a block became final"),
            Field("waiting_s", Kind.SECONDS, "for how long work has waited"),
            Field("late", Kind.BOOL, "whether that is too long"),
        ),
    ),
    Field("suspended_height", Kind.HEIGHT, "where its producer was suspended", null="if it is not", absent=_SILENT),
    Field(
        "accused",
        Kind.ROWS,
        "nodes that are proved to have contradicted themselves, by this node's own words",
        absent=_SILENT,
        fields=(
            Field("name", Kind.TEXT, "the node"),
            Field("state", Kind.TEXT, "`evidence` (held here, not on the chain yet) or `suspended`"),
            Field("height", Kind.HEIGHT, "where it was suspended", null="before that"),
        ),
    ),
    Field(
        "certificate",
        Kind.OBJECT,
        "its certificate",
        absent=_SILENT,
        fields=(
            Field("serial", Kind.TEXT, "its serial number, hexadecimal digits"),
            Field("state", Kind.TEXT, "`valid`, `expiring` (in its last 30 days) or `expired`"),
            Field("not_before_ms", Kind.TIME_MS, "since when it counts"),
            Field("not_after_ms", Kind.TIME_MS, "until when"),
            Field("expires", Kind.TEXT, "the same, as `2028-11-21 12:45 UTC`"),
        ),
    ),
    Field("refused_peers", Kind.ROWS, "nodes that it refused in the last minute", absent=_SILENT, fields=_REFUSALS),
    Field("cut_off_peers", Kind.ROWS, "nodes that sent what no honest one sends", absent=_SILENT, fields=_CUT_OFF),
    Field(
        "over_budget",
        Kind.ROWS,
        "who asked for more work than he may cause, sent faster than he is read, or shook hands too often",
        absent=_SILENT,
        fields=_OVER_BUDGET,
    ),
    Field("refused_by", Kind.ROWS, "nodes that refused it in the last minute", absent=_SILENT, fields=_REFUSALS),
    Field(
        "problem",
        Kind.OBJECT,
        "why no node would talk to it",
        null="if nothing stands in the way",
        absent=_SILENT,
        fields=_WHY,
    ),
    Field("now_ms", Kind.TIME_MS, "its own clock", absent=_SILENT),
    Field(
        "contracts",
        Kind.OBJECT,
        "how it runs contracts",
        absent=_SILENT,
        fields=(
            Field("wall", Kind.TEXT, "how far they are walled in; `off`: they run in the node's own process"),
            Field("blocks", Kind.OBJECT, "the worker for blocks", absent="with `off`", fields=_WORKER),
            Field("views", Kind.OBJECT, "the worker for views", absent="with `off`", fields=_WORKER),
        ),
    ),
    Field("quorum", Kind.COUNT, "how many producers make a quorum in its epoch", absent=_SILENT),
    Field("producers", Kind.TEXTS, "names of the nodes that have a seat in it, in turn", absent=_SILENT),
    Field(
        "rounds",
        Kind.ROWS,
        "its last rounds",
        absent=_SILENT,
        fields=(
            Field("epoch", Kind.COUNT, "the epoch"),
            Field("round", Kind.COUNT, "the round"),
            Field("leader", Kind.TEXT, "who led it", null="if its name is not known"),
            Field("said", Kind.COUNTS_BY_NAME, "which words it said, and when (time in ms, by its own clock)"),
        ),
    ),
    Field("version", Kind.TEXT, "its version of BlockRobot", absent=_SILENT),
    Field("uptime_s", Kind.SECONDS, "since it was started", absent=_SILENT),
)

_WATCHED = (
    Field("at_s", Kind.SECONDS, "since the watching began"),
    Field("finalized_height", Kind.HEIGHT, "the highest that any node says; -1 before any did"),
    Field("finality_age_s", Kind.SECONDS, "since a height was last seen to become final"),
    Field("stuck_s", Kind.SECONDS, "for how long work has waited without anything becoming final"),
    Field("longest_stuck_s", Kind.SECONDS, "the longest such time"),
    Field(
        "nodes",
        Kind.ROWS,
        "each node",
        fields=(
            Field("name", Kind.TEXT, "the node"),
            Field("state", Kind.TEXT, "`stopped`, `paused`, `no answer`, `waiting`, `suspended`, `signing` or a fault"),
            Field("height", Kind.HEIGHT, "its newest certified block", null="if it does not answer"),
            Field("finalized_height", Kind.HEIGHT, "its newest final block", null="likewise"),
            Field("round", Kind.COUNT, "its round", null="likewise"),
            Field("epoch", Kind.COUNT, "its epoch", null="likewise"),
            Field("leader", Kind.TEXT, "the node that leads the round", null="likewise"),
            Field("peers", Kind.COUNT, "how many nodes it is connected to", null="likewise"),
            Field("waiting", Kind.COUNT, "transactions that wait", null="likewise"),
            Field("faults", Kind.TEXTS, "faults that are on"),
            Field("accused_by", Kind.TEXTS, "other nodes that say that it contradicted itself, or is suspended"),
        ),
    ),
    Field("changes", Kind.TEXTS, "what changed since the line before, a sentence each"),
)

_NODES = Field(
    "nodes",
    Kind.ROWS,
    "each node",
    fields=(Field("name", Kind.TEXT, "the node"), Field("running", Kind.BOOL, "whether its process runs"), *_STATUS),
)
_NETWORK = (Field("directory", Kind.TEXT, "the network's folder"), _NODES)

_STEP = (
    Field("at_ms", Kind.MS, "when, from the plan's beginning"),
    Field("line", Kind.COUNT, "the plan's line"),
    Field("do", Kind.TEXT, "what"),
    Field(
        "error",
        Kind.OBJECT,
        "why it was not done",
        null="if it was",
        absent="with `--dry-run`",
        fields=(Field("code", Kind.TEXT, "the error's code"), Field("detail", Kind.TEXT, "what happened")),
    ),
)

_SWITCHED = (
    Field(
        "links",
        Kind.ROWS_BY_NAME,
        "what is wrong with the link to each node",
        fields=(
            Field("delay_ms", Kind.MS, "how long every frame waits"),
            Field("jitter_ms", Kind.MS, "up to so much more, by chance"),
            Field("loss", Kind.NUMBER, "the share of frames that vanish"),
            Field("bandwidth_bytes_per_s", Kind.COUNT, "bytes a second; 0: no limit"),
            Field("cut", Kind.BOOL, "whether nothing gets through"),
        ),
    ),
    Field("clock_offset_ms", Kind.MS, "by how much its clock is wrong"),
    Field("disk", Kind.TEXTS, "which of its disks are full"),
    Field("seed", Kind.COUNT, "what the chance of its links is drawn from"),
    Field("frames_lost", Kind.COUNT, "how many frames vanished so"),
)

_FAULTS = (
    CommandAnswer(
        tuple(
            f"fault {name}"
            for name in ("kill", "restart", "pause", "resume", "partition", "heal", "link", "skew", "disk", "byzantine")
        ),
        (Field("done", Kind.TEXT, "what was done"),),
    ),
    CommandAnswer(
        ("fault list",),
        (
            Field(
                "nodes",
                Kind.ROWS,
                "each node",
                fields=(
                    Field("name", Kind.TEXT, "the node"),
                    Field("running", Kind.BOOL, "whether its process runs"),
                    Field("paused", Kind.BOOL, "whether it is paused"),
                    Field("behaviour", Kind.TEXT, "how it lies; empty if it is honest"),
                    Field(
                        "switched",
                        Kind.OBJECT,
                        "what its own switch says is on",
                        null="if it does not say",
                        fields=_SWITCHED,
                    ),
                    Field("faults", Kind.TEXTS, "all of that, a few words each"),
                ),
            ),
        ),
    ),
    CommandAnswer(
        ("fault run",),
        (
            Field("seed", Kind.COUNT, "what its chance was drawn from"),
            Field("steps", Kind.ROWS, "each step", fields=_STEP),
        ),
        not_ok="if a step could not be done, or no node runs any more",
    ),
)

ANSWERS: tuple[CommandAnswer, ...] = (
    CommandAnswer(
        ("up", "status"),
        _NETWORK,
        not_ok="if a node is stopped, or does not answer",
        lines="`up --console` prints the object of `console` instead, `status --watch` [an object on each "
        "line](#status---watch).",
    ),
    CommandAnswer(("down",), (Field("stopped", Kind.TEXTS, "names of the nodes that ran"),)),
    CommandAnswer(
        ("logs",),
        (
            Field(
                "lines",
                Kind.ROWS,
                "each line",
                fields=(Field("node", Kind.TEXT, "the node"), Field("line", Kind.TEXT, "the line, itself JSON")),
            ),
        ),
    ),
    CommandAnswer(
        ("console",),
        (
            Field("url", Kind.TEXT, "the page's address; alone it opens nothing"),
            Field("open", Kind.TEXT, "the file that opens the page, once"),
        ),
        lines="Printed once the page is there; the command then runs until it is stopped.",
    ),
    CommandAnswer(
        ("explore",),
        (
            Field("node", Kind.TEXT, "whose explorer it is"),
            Field("as", Kind.TEXT, "as whom you look"),
            Field("redirect_file", Kind.TEXT, "the file that opens the page, once"),
            Field("valid_s", Kind.SECONDS, "for how long it does"),
        ),
    ),
    *_FAULTS,
)
"""What these commands answer."""

WATCHED = CommandAnswer(
    ("status --watch",),
    _WATCHED,
    lines="An object on each line, for each change. There is no `ok` in it.",
    has_ok=False,
)
"""What `status --watch` prints on each line."""
