"""Who may be recorded, for what, by which sensor and until when, as each person says it. Must never let another speak,
but for who acts for them by a mandate, within it, and never beyond their own last word.

A no holds from the next block on. A giving holds from the height that it names, or GIVING_AFTER_BLOCKS after its block.
It names the newest final block that they knew when they signed it, and counts only while they have said nothing since: a
giving that somebody held back does not undo a later word. A no always counts, also where nothing was given. A row has at
most what holds now and one word that is still to come. What it keeps: docs/reference/state.md.
"""

HANDLE_BYTES = 32
SENSORS = ("audio", "depth", "emotion", "rgb")
FIRST_SENSORS = ("depth",)
RECORDED_ROLES = ("subject", "staff")
PURPOSES_MAX_COUNT = 16
GIVING_AFTER_BLOCKS = 1
AHEAD_MAX_BLOCKS = 10000000
PERIOD_STEP_MS = 300000
TIME_MAX_MS = 9007199254740992
NOTICE_MAX_BYTES = 14000
NOTICE_TAG = "blockrobot/notice"
GIVEN = "given"
REFUSED = "refused"
WITHDRAWN = "withdrawn"
OBJECTED = "objected"
MANDATED_ACT = "consent"
OWN = b""
ALL_OTHERS = ""


def require_person(handle: bytes) -> dict | None:
    """Only a person who can be recorded speaks, or who acts for them, in a transaction of their own: see `find_mandate`."""
    require(ctx.calling_contract == "", "CALL_INDIRECT", "Only a transaction does that, no other contract in its name.")
    return find_mandate(handle)


def find_mandate(handle: bytes) -> dict | None:
    """Return the mandate under which the caller speaks for a person; None if they speak themselves."""
    require(len(handle) == HANDLE_BYTES, "HANDLE_SIZE_WRONG", "A handle has 32 bytes.")
    found = call("identity", "member_of_handle", handle)
    require(found is not None, "HANDLE_UNKNOWN", "Nobody is registered under this handle.")
    mandate = None
    if found["member"] != ctx.caller:
        mandate = call("mandates", "acting_for", handle, ctx.caller, MANDATED_ACT)
        require(mandate is not None, "NOT_THE_MEMBER", "The caller is not registered under this handle.")
    require(found["status"] == "active", "MEMBER_NOT_ACTIVE", "The member has left.")
    require(found["role"] in RECORDED_ROLES, "NOT_RECORDED", "Only who may be recorded has something to consent to.")
    return mandate


def id_of(mandate: dict | None) -> bytes:
    return b"" if mandate is None else mandate["mandate_id"]


def standing(steps: list) -> list:
    """Return the step that holds now and those that are still to come."""
    now = holding(steps, ctx.height)
    return [step for step in steps if step == now or step[0] > ctx.height]


def own_nos(steps: list) -> list:
    """Return the person's own nos that hold now or will: they stay that person's, whoever says no as well."""
    return [step for step in standing(steps) if step[1] != GIVEN and step[5] == OWN]


def note_act(mandate: dict | None, kind: str, purposes: list, sensors: list, from_ms: int, until_ms: int):
    if mandate is not None:
        data = {"purposes": purposes, "sensors": sensors, "from_ms": from_ms, "until_ms": until_ms}
        call("mandates", "note", mandate["mandate_id"], kind, data)


def require_identity():
    require(ctx.calling_contract == "identity", "NOT_THE_IDENTITY_CONTRACT", "Only the contract identity may do that.")


def check_purposes(purposes: list):
    require(len(purposes) <= PURPOSES_MAX_COUNT, "PURPOSES_TOO_MANY", "At most 16 purposes may be named.")
    for code in purposes:
        known = isinstance(code, str) and call("identity", "purpose_known", code)
        require(known, "PURPOSE_UNKNOWN", "The purpose is not published.")


def check_sensors(sensors: list):
    require(len(sensors) <= len(SENSORS), "SENSOR_UNKNOWN", "There are not so many sensors.")
    for code in sensors:
        require(isinstance(code, str) and code in SENSORS, "SENSOR_UNKNOWN", "There is no such sensor.")


def check_period(from_ms: int, until_ms: int):
    """A period begins and ends on five full minutes: an exact time would be a mark of whoever chose it."""
    for moment in [from_ms, until_ms]:
        whole = 0 <= moment and moment < TIME_MAX_MS and moment % PERIOD_STEP_MS == 0
        require(whole, "PERIOD_WRONG", "A period begins and ends on five full minutes.")
    open_yet = until_ms == 0 or until_ms > max(from_ms, ctx.time)
    require(open_yet, "PERIOD_WRONG", "The period would be over before it begins.")


def holding(steps: list, height: int) -> list | None:
    """Return the step that holds at a height, or None."""
    found = None
    for step in steps:
        if step[0] <= height:
            found = step
    return found


def say(row: dict, purpose: str, sensor: str, step: list):
    """Put a new word behind what holds now: it ends every other that is still to come.

    A giving that prolongs what holds keeps since when it has held.
    """
    require(purpose in row or len(row) < PURPOSES_MAX_COUNT, "PURPOSES_TOO_MANY", "At most 16 purposes may be named.")
    sensors = row.get(purpose, {})
    kept = []
    now = holding(sensors.get(sensor, []), ctx.height)
    if now is not None:
        kept = [now]
        if step[1] == GIVEN and lasts_until(now, step[0]):
            step = [step[0], GIVEN, max(now[2], now[3]), step[3], step[4], step[5]]
    sensors[sensor] = kept + [step]
    row[purpose] = sensors


def lasts_until(now: list, height: int) -> bool:
    """Tell whether what holds now is a consent whose period has begun and does not end before a later height.

    When a block to come will be made nobody knows: an end counts as later than the next block, and than no other.
    """
    if now[1] != GIVEN or now[3] > ctx.time:
        return False
    return now[4] == 0 or (height == ctx.height + 1 and now[4] > ctx.time)


def keep(handle: bytes, row: dict):
    state.put(b"of/" + handle, row)
    note_change()


def note_own(handle: bytes, purposes: list, sensors: list, word: list | None):
    """Keep what a person said last themselves of these choices; no purpose named: of everything."""
    own = state.get(b"own/" + handle, {})
    for sensor in sensors:
        if len(purposes) == 0:
            own[sensor] = {ALL_OTHERS: word}
        words = own.get(sensor, {})
        for purpose in purposes:
            words[purpose] = word
        own[sensor] = words
    state.put(b"own/" + handle, own)


def leaves_free(words: dict, purpose: str, from_ms: int, until_ms: int) -> bool:
    """Tell whether a yes of another's stays within the person's own last word, if there is one.

    Their yes opens nothing before its height: another's would end it while it is still to come.
    """
    if purpose not in words:
        return ALL_OTHERS not in words
    own = words[purpose]
    if own is None or own[0] > ctx.height or max(from_ms, ctx.time) < own[1]:
        return False
    return own[2] == 0 or until_ms <= own[2]


def note_word(handle: bytes):
    state.put(b"said/" + handle, ctx.height)


def check_newest(handle: bytes, seen: int):
    """A giving answers all that its person has said: it was signed when their last word was final."""
    require(0 <= seen and seen < ctx.height, "HEIGHT_WRONG", "The newest block that was known is an earlier one.")
    newest = seen >= state.get(b"said/" + handle, 0)
    require(newest, "WORD_OLDER", "Something was said after this was signed: look at what holds now and say it again.")


def note_change():
    state.put(b"changes", state.get(b"changes", 0) + 1)


@export
def give(handle: bytes, purposes: list, sensors: list, from_ms: int, until_ms: int, height: int, seen: int):
    """Consent to be recorded, from a height on (0: soon) and in a period.

    `seen` is the height of the newest final block that they knew: nothing was said after it. Who acts for them names an end,
    within the mandate, and gives nothing beyond their own last word. Who may call: the person of the handle, or who acts for them by a mandate.
    """
    mandate = require_person(handle)
    check_purposes(purposes)
    check_sensors(sensors)
    check_period(from_ms, until_ms)
    named = len(purposes) > 0 and len(sensors) > 0
    require(named, "CHOICE_MISSING", "A consent names its purposes and its sensors.")
    if height == 0:
        height = ctx.height + GIVING_AFTER_BLOCKS
    ahead = height > ctx.height and height <= ctx.height + AHEAD_MAX_BLOCKS
    require(ahead, "HEIGHT_WRONG", "A consent takes effect at a later block.")
    check_newest(handle, seen)
    if mandate is not None:
        within = 0 < until_ms and until_ms <= mandate["until_ms"]
        require(within, "BEYOND_MANDATE", "Who acts for another names an end, not later than the mandate's.")
    row = state.get(b"of/" + handle, {})
    own = state.get(b"own/" + handle, {})
    for purpose in purposes:
        for sensor in sensors:
            if mandate is not None:
                free = leaves_free(own.get(sensor, {}), purpose, from_ms, until_ms)
                require(free, "OWN_NO_STANDS", "Beyond what the person said themselves nobody else can say yes.")
            say(row, purpose, sensor, [height, GIVEN, ctx.time, from_ms, until_ms, id_of(mandate)])
    if mandate is None:
        note_own(handle, purposes, sensors, [height, from_ms, until_ms])
    keep(handle, row)
    note_word(handle)
    note_act(mandate, GIVEN, purposes, sensors, from_ms, until_ms)
    told = {"member": ctx.caller, "purposes": purposes, "sensors": sensors, "height": height}
    told["mandate"] = id_of(mandate)
    emit("given", told)


@export
def refuse(handle: bytes, purposes: list, sensors: list):
    """Say no, whatever was said before; no sensor named: to all.

    Who may call: the person of the handle, or who acts for them by a mandate.
    """
    mandate = require_person(handle)
    check_purposes(purposes)
    check_sensors(sensors)
    require(len(purposes) > 0, "CHOICE_MISSING", "A refusal names its purposes.")
    if len(sensors) == 0:
        sensors = [sensor for sensor in SENSORS]
    say_no(handle, mandate, REFUSED, purposes, sensors)
    told = {"member": ctx.caller, "purposes": purposes, "sensors": sensors, "height": ctx.height + 1}
    told["mandate"] = id_of(mandate)
    emit("refused", told)


@export
def objected(handle: bytes, purposes: list):
    """Write that a person objects to purposes: a no by all sensors. Who may call: the contract `rights`, for themselves."""
    require(ctx.calling_contract == "rights", "NOT_THE_RIGHTS_CONTRACT", "Only the contract rights may do that.")
    mandate = find_mandate(handle)
    check_purposes(purposes)
    say_no(handle, mandate, OBJECTED, purposes, [sensor for sensor in SENSORS])
    told = {"member": ctx.caller, "purposes": purposes, "height": ctx.height + 1, "mandate": id_of(mandate)}
    emit("objected", told)


def say_no(handle: bytes, mandate: dict | None, status: str, purposes: list, sensors: list):
    """Write a no to each of these choices."""
    if mandate is None:
        note_own(handle, purposes, sensors, None)
    row = state.get(b"of/" + handle, {})
    count = 0
    for purpose in purposes:
        for sensor in sensors:
            count += deny(row, purpose, sensor, status, mandate)
    finish_no(handle, row, mandate, status, purposes, sensors, count)


def deny(row: dict, purpose: str, sensor: str, status: str, mandate: dict | None) -> int:
    """Write a no to one choice; return 1 if that changed it, else 0.

    The person's own no stays when another says it, too: only what was to come after it goes.
    """
    if mandate is not None:
        steps = row.get(purpose, {}).get(sensor, [])
        own = own_nos(steps)
        if len(own) > 0:
            changed = len(own) < len(standing(steps))
            row[purpose][sensor] = own
            return 1 if changed else 0
        if len(steps) > 0 and steps[-1][1] != GIVEN and (status != OBJECTED or steps[-1][1] == OBJECTED):
            return 0
    say(row, purpose, sensor, [ctx.height + 1, status, ctx.time, 0, 0, id_of(mandate)])
    return 1


def finish_no(handle: bytes, row: dict, mandate: dict | None, status: str, purposes: list, sensors: list, count: int):
    """Keep a no; one that changed nothing ends a giving that is under way, and leaves nothing in the mandate's trail."""
    note_word(handle)
    if count > 0:
        keep(handle, row)
        note_act(mandate, status, purposes, sensors, 0, 0)


@export
def withdraw(handle: bytes, purposes: list, sensors: list):
    """Take back what was given; no purpose or sensor named: every one.

    It counts where nothing was given, too: a giving that is still under way comes too late then, and who acts for a
    person gives nothing that the person took back. Who may call: the person of the handle, or who acts for them by a
    mandate.
    """
    mandate = require_person(handle)
    check_purposes(purposes)
    check_sensors(sensors)
    row = state.get(b"of/" + handle, {})
    count = 0
    if mandate is None:
        count = withdraw_ahead(handle, row, purposes, sensors)
    for purpose in row:
        if len(purposes) == 0 or purpose in purposes:
            for sensor in row[purpose]:
                if (len(sensors) == 0 or sensor in sensors) and row[purpose][sensor][-1][1] == GIVEN:
                    count += deny(row, purpose, sensor, WITHDRAWN, mandate)
    finish_no(handle, row, mandate, WITHDRAWN, purposes, sensors, count)
    told = {"member": ctx.caller, "purposes": purposes, "sensors": sensors, "height": ctx.height + 1, "count": count}
    told["mandate"] = id_of(mandate)
    emit("withdrawn", told)


def withdraw_ahead(handle: bytes, row: dict, purposes: list, sensors: list) -> int:
    """Write a person's own no also to what they had not given; return to how many choices.

    Where they name no purpose it stands in no step, and in their own last word.
    """
    if len(sensors) == 0:
        sensors = [sensor for sensor in SENSORS]
    note_own(handle, purposes, sensors, None)
    count = 0
    for purpose in purposes:
        for sensor in sensors:
            steps = row.get(purpose, {}).get(sensor, [])
            if len(own_nos(steps)) == 0 and (len(steps) == 0 or steps[-1][1] != GIVEN):
                count += deny(row, purpose, sensor, WITHDRAWN, None)
    return count


@export
def end_mandate(handle: bytes, mandate_id: bytes):
    """Take back what was given under a mandate that has ended. Who may call: the contract `mandates`."""
    require(ctx.calling_contract == "mandates", "NOT_THE_MANDATES_CONTRACT", "Only the contract mandates may do that.")
    row = state.get(b"of/" + handle, {})
    count = 0
    for purpose in row:
        for sensor in row[purpose]:
            steps = row[purpose][sensor]
            now, last = holding(steps, ctx.height), steps[-1]
            no = [ctx.height + 1, WITHDRAWN, ctx.time, 0, 0, mandate_id]
            if last[1] == GIVEN and last[5] == mandate_id:
                say(row, purpose, sensor, no)
                count += 1
            elif last[0] > no[0] and now is not None and now[1] == GIVEN and now[5] == mandate_id:
                row[purpose][sensor] = [no, last]
                count += 1
    if count > 0:
        keep(handle, row)


@export
def begin(handle: bytes, purposes: list):
    """Write the first consents of who registers, to the depth camera alone. Who may call: the contract `identity`."""
    require_identity()
    row = {}
    for purpose in purposes:
        for sensor in FIRST_SENSORS:
            say(row, purpose, sensor, [ctx.height + GIVING_AFTER_BLOCKS, GIVEN, ctx.time, 0, 0, OWN])
    keep(handle, row)


@export
def end(handle: bytes):
    """Forget the choices of who is no member any more. Who may call: the contract `identity`."""
    require_identity()
    state.delete(b"of/" + handle)
    state.delete(b"own/" + handle)
    state.delete(b"said/" + handle)
    note_change()


@export
def publish_notice(document: bytes):
    """Publish the next version of what its people are told. Who may call: an admin of an active organisation.

    What the document says is not looked at here: whoever reads it checks its form.
    """
    require(ctx.calling_contract == "", "CALL_INDIRECT", "Only a transaction does that, no other contract in its name.")
    organisation = call("identity", "admin_of", ctx.caller)
    require(organisation != "", "NOT_AN_ADMIN", "Only an admin of an organisation publishes what it tells people.")
    sized = 0 < len(document) and len(document) <= NOTICE_MAX_BYTES
    require(sized, "NOTICE_SIZE_WRONG", "A notice has between 1 and 14,000 bytes.")
    digest = tagged_hash(NOTICE_TAG, document)
    newest = state.get(b"notice/" + organisation.encode())
    version = 1
    if newest is not None:
        require(newest["hash"] != digest, "NOTICE_UNCHANGED", "This is the version that is in force.")
        version = newest["version"] + 1
    row = {"version": version, "hash": digest, "height": ctx.height, "time": ctx.time}
    state.put(b"notice/" + organisation.encode(), row)
    row["document"] = document
    state.put(b"notice-text/" + u32(version) + organisation.encode(), row)
    emit("notice_published", {"organisation": organisation, "version": version, "hash": digest})


@view
def choices(handle: bytes) -> dict:
    """Return {purpose: {sensor: [step, ...]}} of a handle; empty if nothing was ever said."""
    return state.get(b"of/" + handle, {})


@view
def allowed(handle: bytes, purpose: str, sensor: str) -> bool:
    """Tell whether a consent holds in this block, and its period is open."""
    now = holding(state.get(b"of/" + handle, {}).get(purpose, {}).get(sensor, []), ctx.height)
    if now is None or now[1] != GIVEN:
        return False
    return now[3] <= ctx.time and (now[4] == 0 or ctx.time < now[4])
