"""Handing over controlled medication: nothing leaves the cabinet without two signatures.

A pharmacist is named when the cabinet is set up and names the nurses. A nurse asks for a dose; a second nurse, who saw
the ampoule and the patient's wristband, confirms by a signature made at the bedside, without their own transaction.
Only then is the stock reduced. An unconfirmed request ends after ten minutes.
"""

TAG = "medication/confirm"
REQUEST_LIFETIME_MS = 10 * 60_000
UNITS_MAX = 20


def require_pharmacist():
    require(state.get(b"pharmacist") == ctx.caller, "NOT_PHARMACIST", "Only the pharmacist does that.")


def require_nurse(key: bytes):
    require(state.has(b"nurse/" + key), "NOT_NURSE", "Only a nurse of this ward does that.")


def message_of(number: int, request: dict) -> bytes:
    """What the second nurse signs: chain, contract, number, drug, units and patient, so that it fits nothing else."""
    parts = [ctx.contract.encode(), request["drug"].encode(), request["patient"]]
    return ctx.chain + u64(number) + u64(request["units"]) + b"".join([u32(len(part)) + part for part in parts])


@export
def set_up():
    """Become the cabinet's pharmacist; whoever comes first."""
    require(not state.has(b"pharmacist"), "SET_UP_ALREADY", "The cabinet has a pharmacist.")
    state.put(b"pharmacist", ctx.caller)


@export
def name_nurse(key: bytes, active: bool):
    """Let a nurse take part, or no more."""
    require_pharmacist()
    require(len(key) == 33, "KEY_WRONG", "A key has 33 bytes.")
    if active:
        state.put(b"nurse/" + key, True)
    else:
        state.delete(b"nurse/" + key)


@export
def fill(drug: str, units: int) -> int:
    """Put units of a drug into the cabinet; return how many there are."""
    require_pharmacist()
    require(0 < len(drug) <= 60 and units > 0, "FILL_WRONG", "Name a drug and how many units.")
    stock = state.get(b"stock/" + drug.encode(), 0) + units
    state.put(b"stock/" + drug.encode(), stock)
    emit("filled", {"drug": drug, "units": units, "stock": stock})
    return stock


@export
def request(drug: str, units: int, patient: bytes) -> int:
    """Ask for units of a drug for a patient (a hash, never a name); return the request's number."""
    require_nurse(ctx.caller)
    require(0 < units <= UNITS_MAX, "UNITS_WRONG", "One request is for 1 to 20 units.")
    require(len(patient) == 32, "PATIENT_WRONG", "A patient is named by a hash of 32 bytes.")
    require(state.get(b"stock/" + drug.encode(), 0) >= units, "STOCK_TOO_LOW", f"There is not so much {drug}.")
    number = state.get(b"requests", 0) + 1
    state.put(b"requests", number)
    asked = {"drug": drug, "units": units, "patient": patient, "first": ctx.caller, "second": b"", "asked": ctx.time}
    state.put(b"request/" + u64(number), asked)
    emit("asked", {"number": number, "drug": drug, "units": units})
    return number


@export
def hand_over(number: int, signature: bytes):
    """Take the units out, with the signature of a second nurse over the request."""
    found = state.get(b"request/" + u64(number))
    require(found is not None, "REQUEST_UNKNOWN", "There is no such request.")
    require(found["first"] == ctx.caller, "NOT_YOURS", "Who asked hands over.")
    require(found["second"] == b"", "HANDED_OVER", "That was handed over already.")
    require(ctx.time <= found["asked"] + REQUEST_LIFETIME_MS, "REQUEST_OLD", "A request holds for ten minutes.")
    second = recover(TAG, signature, message_of(number, found))
    require(second is not None, "SIGNATURE_WRONG", "That is no signature.")
    require(second != ctx.caller, "SAME_NURSE", "The second signature is somebody else's.")
    require_nurse(ctx.caller)
    require_nurse(second)
    stock = state.get(b"stock/" + found["drug"].encode(), 0)
    require(stock >= found["units"], "STOCK_TOO_LOW", "Others took it meanwhile.")
    state.put(b"stock/" + found["drug"].encode(), stock - found["units"])
    found["second"] = second
    state.put(b"request/" + u64(number), found)
    emit("handed_over", {"number": number, "drug": found["drug"], "units": found["units"], "second": second})


@view
def stock(drug: str) -> int:
    return state.get(b"stock/" + drug.encode(), 0)


@view
def to_sign(number: int) -> bytes:
    """What the second nurse signs for a request, under the tag medication/confirm."""
    found = state.get(b"request/" + u64(number))
    require(found is not None, "REQUEST_UNKNOWN", "There is no such request.")
    return message_of(number, found)


@view
def handed_over(number: int) -> dict | None:
    return state.get(b"request/" + u64(number))
