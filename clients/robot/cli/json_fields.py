"""JSON fields of `blockrobot robot --json`."""

from __future__ import annotations

from clients.sdk.terminal.json_fields import CommandAnswer, Field, Kind

_MEMBER = Field("member", Kind.HEX, "the robot's member key")

_SEALED = Field("sealed", Kind.BOOL, "whether a passphrase opens the key file")

_VIEWPOINT = (
    Field("viewpoint", Kind.TEXT, "the viewpoint's name"),
    Field("state", Kind.TEXT, "`recorded`, `approved`, `expired`, or `changed` since it was approved"),
    Field("frames", Kind.COUNT, "how many empty frames it has"),
    Field("approved_by", Kind.TEXT, "who approved them; empty until somebody did"),
    Field("expires_at_ms", Kind.TIME_MS, "until when that holds; 0 until approved"),
    Field("preview", Kind.TEXT, "the picture to look at before approving"),
    Field("digest", Kind.HEX, "what of them an approval is bound to"),
)

_WITH_TOPIC = (
    Field("topic", Kind.TEXT, "the topic's name"),
    Field("type", Kind.TEXT, "its message type"),
    Field("count", Kind.COUNT, "how many messages"),
    Field("rate_hz", Kind.NUMBER, "messages a second"),
    Field("encoding", Kind.TEXT, "how pictures in it are encoded", null="if it has none, or none was seen"),
    Field("could_be", Kind.TEXTS, "what it could be"),
)

_COUNTED = (
    Field("published", Kind.COUNT, "how many came"),
    Field("covered", Kind.COUNT, "how many of them, once for each owner whom one is about"),
    Field("kept", Kind.COUNT, "how many of these are recorded, and final"),
    Field("withheld", Kind.COUNT, "how many of these are withheld"),
    Field("withheld_reasons", Kind.COUNTS_BY_NAME, "the same by reason"),
    Field("lost", Kind.COUNT, "how many of these are neither"),
)

_TO_THE_END = "if the run was ended at once"
_LATENCY = (
    Field("p50", Kind.MS, "the median"),
    Field("p95", Kind.MS, "the 95th percentile"),
    Field("max", Kind.MS, "the longest"),
)
_NEVER_LIVE = "for a recording, and the synthetic corridor"

_INTAKE = (
    Field(
        "clocks",
        Kind.ROWS_BY_NAME,
        "what was found of each device's clock",
        fields=(
            Field("offset_ms", Kind.MS, "host time minus device time"),
            Field("drift_ppm", Kind.NUMBER, "how fast that grows, in millionths"),
            Field("uncertainty_ms", Kind.MS, "how far it may be off"),
            Field("sample_count", Kind.COUNT, "from how many stamps"),
            Field("started_anew_count", Kind.COUNT, "how often the clock was found to be set"),
        ),
    ),
    Field("turned_away", Kind.COUNTS_BY_NAME, "how much was turned away for its time, by reason"),
    Field("sightings_late", Kind.COUNT, "tag readings that came too late"),
    Field("sightings_shortened", Kind.COUNT, "tag readings whose uncertain end was cut"),
    Field("sightings_only_paired", Kind.COUNT, "tag readings that were thinned out"),
    Field("timelines", Kind.COUNT, "how many timelines the stamps made"),
    Field(
        "unknown_tags",
        Kind.OBJECT,
        "tags that are not on the roster",
        fields=(
            Field("readings", Kind.COUNT, "how many readings"),
            Field("tags", Kind.COUNT, "of how many tags"),
            Field("more_tags", Kind.BOOL, "whether there were more than could be told apart"),
        ),
    ),
    Field("messages_refused", Kind.ROWS_BY_NAME, "messages that could not be used: by kind, how many by reason"),
    Field("first_refused", Kind.TEXTS_BY_NAME, "why the first of these could not be used, by kind"),
    Field(
        "antennas_unnamed",
        Kind.ROWS_BY_NAME,
        "by topic: how often antennas were heard that the topics file names neither in `front` nor in `back`",
        absent="for the synthetic corridor",
    ),
    Field(
        "fault",
        Kind.OBJECT,
        "what ended the source",
        null="if it ended properly",
        fields=(Field("code", Kind.TEXT, "the error's code"), Field("detail", Kind.TEXT, "what happened")),
    ),
    Field("missed", Kind.COUNTS_BY_NAME, "what was dropped for lack of room, by kind", absent=_NEVER_LIVE),
    Field("unread", Kind.COUNTS_BY_NAME, "what waited still at the end, by kind", absent=_NEVER_LIVE),
    Field("heard", Kind.COUNTS_BY_NAME, "how many messages came, by topic", absent=_NEVER_LIVE),
    Field("never_came", Kind.COUNTS_BY_NAME, "what was sent and never came, by topic", absent=_NEVER_LIVE),
    Field("gone", Kind.COUNTS_BY_NAME, "how often a topic was gone", absent=_NEVER_LIVE),
)

_RUN = (
    Field("roster_rows", Kind.COUNT, "how many people of the roster the chain has confirmed", absent=_TO_THE_END),
    Field(
        "consents",
        Kind.OBJECT,
        "what was read of consents",
        absent=_TO_THE_END,
        fields=(
            Field("readings", Kind.COUNT, "how often the registry was proved"),
            Field("failed_readings", Kind.COUNT, "how often it could not be"),
            Field("stale_times", Kind.COUNT, "how often what was proved was too old to record by"),
            Field("stale_ms", Kind.MS, "for how long, together"),
            Field(
                "sightings_refused",
                Kind.COUNTS_BY_NAME,
                "tag readings that counted for nothing, by reason: `no-consent`, `consent-coming`, `registry-stale`",
            ),
            Field("clips_dropped", Kind.COUNT, "clips in the spool that a no, or their age, stopped"),
        ),
    ),
    Field("frames", Kind.OBJECT, "depth frames", absent=_TO_THE_END, fields=_COUNTED),
    Field(
        "ambiguous",
        Kind.ROWS,
        "tags with frames withheld as `ambiguous`, most frames first, 16 at most: the matcher's numbers where it came "
        "nearest to a decision",
        absent=_TO_THE_END,
        fields=(
            Field("alias", Kind.TEXT, "the tag's alias in this run, as in the event log"),
            Field("frames", Kind.COUNT, "how many frames"),
            Field(
                "obstacle",
                Kind.TEXT,
                "what stood in the way: `few-distances`, `behind`, `unit`, `delayed`, `off`, `vague`, `rival`, "
                "`no-facing` or `undecided`",
            ),
            Field("log_odds", Kind.NUMBER, "for the person in view who fitted best"),
            Field("needed", Kind.NUMBER, "the log-odds at which a tag is bound"),
            Field("distance_log_odds", Kind.NUMBER, "what distances alone say for that person; 1.1 of it is needed"),
            Field("rival_log_odds", Kind.NUMBER, "for who fitted next best", absent="if one person was in view"),
            Field("distances", Kind.COUNT, "how many distances were compared with the camera's"),
            Field("gap_m", Kind.NUMBER, "mean of distance minus camera range, in metres"),
            Field("spread_m", Kind.NUMBER, "standard deviation of distance minus camera range, in metres"),
            Field(
                "delay_ms",
                Kind.MS,
                "how much later than the person the distances are",
                absent="if no shift makes them fit",
            ),
            Field("sigma_m", Kind.NUMBER, "mean stated standard deviation, in metres"),
            Field("front", Kind.COUNT, "readings by antennas that look as the camera looks"),
            Field("back", Kind.COUNT, "readings by antennas that look away from it"),
            Field("people", Kind.COUNT, "how many people were in view"),
            Field("help", Kind.TEXT, "what helps"),
        ),
    ),
    Field(
        "merged",
        Kind.ROWS,
        "tags with frames withheld as `merged`, most frames first, 16 at most: the silhouette that came nearest to being "
        "taken for one person",
        absent=_TO_THE_END,
        fields=(
            Field("alias", Kind.TEXT, "the tag's alias in this run, as in the event log"),
            Field("frames", Kind.COUNT, "how many frames"),
            Field("by", Kind.TEXT, "which rule took it for two people: `area`, `breadth`, `shape` or `before`"),
            Field("limit", Kind.NUMBER, "above what: square metres, metres, or log-odds (`shape` and `before`)"),
            Field("log_odds", Kind.NUMBER, "of two people"),
            Field("area_m2", Kind.NUMBER, "the silhouette's area in square metres"),
            Field("breadth_m", Kind.NUMBER, "its breadth about half a metre below the top of the head, in metres"),
            Field("range_m", Kind.NUMBER, "how far away it was, in metres"),
            Field("help", Kind.TEXT, "what that means"),
        ),
    ),
    Field(
        "distances_off",
        Kind.ROWS,
        "tags whose frames were kept though their distances disagree with the camera's, 16 at most",
        absent=_TO_THE_END,
        fields=(
            Field("alias", Kind.TEXT, "the tag's alias in this run"),
            Field("frames", Kind.COUNT, "how many frames"),
            Field("gap_m", Kind.NUMBER, "mean of distance minus camera range, in metres"),
            Field("spread_m", Kind.NUMBER, "standard deviation of the same, in metres"),
            Field("sigma_m", Kind.NUMBER, "mean stated standard deviation, in metres"),
        ),
    ),
    Field(
        "senses",
        Kind.ROWS_BY_NAME,
        "the same of each other sensor of which anything came",
        absent=_TO_THE_END,
        fields=(*_COUNTED, Field("let_go", Kind.COUNT, "how many could not wait for a verdict, for lack of memory")),
    ),
    Field(
        "latency_ms",
        Kind.OBJECT,
        "how long frames, or records, took until they were final",
        absent=_TO_THE_END,
        fields=(
            Field("frame_to_final", Kind.OBJECT, "from the end of the pairing window", fields=_LATENCY),
            Field("decided_to_final", Kind.OBJECT, "from when hiding had settled it too", fields=_LATENCY),
            Field("arrival_to_final", Kind.OBJECT, "from when it came", fields=_LATENCY),
            Field("submit_to_final", Kind.OBJECT, "from when it was sent to the network", fields=_LATENCY),
        ),
    ),
    Field("intake", Kind.OBJECT, "what was found of the source", absent=_TO_THE_END, fields=_INTAKE),
    Field(
        "camera",
        Kind.OBJECT,
        "the lens",
        absent=_TO_THE_END,
        fields=(
            Field("focal_px", Kind.NUMBER, "focal length in pixels"),
            Field("focal_from", Kind.TEXT, "where that is from"),
            Field("frames_before", Kind.COUNT, "how many frames came before it was known"),
        ),
    ),
    Field("records", Kind.COUNT, "how many records are final", absent=_TO_THE_END),
    Field("stored_bytes", Kind.COUNT, "how many bytes one custodian stores of them", absent=_TO_THE_END),
    Field("spool_peak_bytes", Kind.COUNT, "the most that waited in the spool at once", absent=_TO_THE_END),
    Field(
        "uploads_refused",
        Kind.COUNTS_BY_NAME,
        "how often a custodian took no upload, by the error's code; most are tried again",
        absent=_TO_THE_END,
    ),
    Field(
        "final_gap_max_s", Kind.SECONDS, "the longest time between two records that became final", absent=_TO_THE_END
    ),
    Field(
        "error",
        Kind.OBJECT,
        "`intake.fault` as in a refusal",
        absent="if the source ended properly",
        fields=(
            Field("code", Kind.TEXT, "the error's code"),
            Field("detail", Kind.TEXT, "what happened"),
            Field("next_step", Kind.TEXT, "what to do"),
        ),
    ),
    Field("ended", Kind.TEXT, "`at-once`", absent="unless the run was ended at once"),
    Field(
        "progress",
        Kind.OBJECT,
        "how far it was",
        absent="unless the run was ended at once",
        fields=(
            Field("frames_read", Kind.COUNT, "frames that came", absent="if it was ended before any figure"),
            Field("frames_recorded", Kind.COUNT, "frames that are final, once for each owner", absent="likewise"),
            Field("records", Kind.COUNT, "records that are final", absent="likewise"),
            Field("waiting", Kind.COUNT, "clips that waited", absent="likewise"),
        ),
    ),
    Field("spooled_clips", Kind.COUNT, "clips that the next run sends", absent="unless the run was ended at once"),
)

ANSWERS: tuple[CommandAnswer, ...] = (
    CommandAnswer(("robot new",), (Field("folder", Kind.TEXT, "the robot's folder"), _MEMBER, _SEALED)),
    CommandAnswer(("robot passphrase",), (_SEALED,)),
    CommandAnswer(
        ("robot register",),
        (Field("txid", Kind.HEX, "the registration", null="if it had registered with this card before"), _MEMBER),
    ),
    CommandAnswer(
        ("robot topics",),
        (
            Field("topics", Kind.ROWS, "each topic", fields=_WITH_TOPIC),
            Field("broken", Kind.TEXT, "where and how the recording breaks off", null="if it does not"),
            Field("draft", Kind.TEXT, "the topics file that was written", null="without `--draft`"),
            Field("next_steps", Kind.TEXTS, "what to do next, a sentence each"),
        ),
    ),
    CommandAnswer(("robot background record", "robot background approve"), _VIEWPOINT),
    CommandAnswer(("robot background list",), (Field("viewpoints", Kind.ROWS, "each viewpoint", fields=_VIEWPOINT),)),
    CommandAnswer(
        ("robot replay", "robot run"),
        _RUN,
        not_ok="if anything was lost, never came or was not read, if the source broke off, or if a second Ctrl-C ended"
        " the run at once",
        lines='While it runs, each line on standard error is `{"progress": {...}}` with the fields of `progress` below, '
        'or `{"notice": "..."}`.',
    ),
)
"""What these commands answer."""
