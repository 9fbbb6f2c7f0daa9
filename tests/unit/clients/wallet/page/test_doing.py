"""What is done in the page: opened, judged, said, shared, ended, erased. Each by the same code as the commands."""

from __future__ import annotations

import asyncio
from typing import Any

import msgspec
import pytest

from clients.wallet.commands import serve_commands
from clients.wallet.consent.consent_choices import round_period
from clients.wallet.page import session as sessions
from clients.wallet.page.jobs import Job, Jobs
from clients.wallet.page.page_answers import QUIET_HEADER
from clients.wallet.page.request_fields import IDS_MAX_COUNT
from clients.wallet.page.routes import clip_routes
from clients.wallet.records.erasure import ErasureClient
from consensus.errors import BlockRobotError
from consensus.members.handles import encode_short
from consensus.members.vouchers import encode_card_code
from consensus.rights.notices import encode_notice
from network.notices.notice_publishing import demo_notice
from tests.miscounting_robot import committing_otherwise, miscounting
from tests.unit.clients.wallet.page.conftest import PASSPHRASE, PageHarness
from tests.world.sharing import WEEK_MS


async def recorded(desk: PageHarness, count: int = 2) -> list[str]:
    _, ids = desk.ward.record_visit(count)
    await desk.read()
    return [record_id.hex() for record_id in ids]


async def judged(desk: PageHarness, ids: list[str]) -> dict[str, Any]:
    """Open recordings and write down what was found; return that."""
    opened = await desk.page.do("/api/clips", {"records": ids})
    return await desk.page.do(f"/api/clips/{opened['clip']}/verdict")


async def test_a_clip_is_opened_checked_and_shown_frame_by_frame(desk: PageHarness) -> None:
    ids = await recorded(desk)
    opened = await desk.page.do("/api/clips", {"records": ids})
    assert [(seal["state"], seal["frames_ok"]) for seal in opened["seals"]] == [("good", 2), ("good", 2)]
    head = desk.ward.chain.head
    assert opened["seals"][0]["proved_height"] <= head.height
    clip = await desk.page.get(f"/api/clips/{opened['clip']}")
    assert [frame["number"] for frame in clip["frames"]] == [0, 1, 2, 3]
    assert {frame["kind"] for frame in clip["frames"]} == {"depth"}
    path = f"/api/clips/{opened['clip']}/frames/2"
    whole, own = await desk.page.get(f"{path}/depth"), await desk.page.get(f"{path}/depth", own=1)
    frame = clip["frames"][2]
    assert len(whole) == len(own) == 2 * frame["width"] * frame["height"]
    assert whole[:2] == (5_000).to_bytes(2, "little"), "the empty room"
    assert own[:2] == bytes(2)
    assert (await desk.page.get(f"{path}/depth.png")).startswith(b"\x89PNG")
    assert (await desk.page.get(f"/api/records/{ids[0]}"))["clip"] == opened["clip"]
    for number in ("4", "-1", "x"):
        assert await desk.page.refused("GET", f"/api/clips/{opened['clip']}/frames/{number}/file") == "NOT_FOUND"


async def test_a_changed_frame_makes_the_seal_red_and_is_not_shown(desk: PageHarness) -> None:
    ids = await recorded(desk)
    desk.ward.spoil(bytes.fromhex(ids[0]), 1)
    opened = await judged(desk, ids[:1])
    (seal,) = opened["seals"]
    assert (seal["state"], seal["corrupted"]) == ("bad", [1])
    assert {check["code"] for check in seal["checks"] if not check["ok"]} == {"ciphertext"}
    assert not {check["code"] for check in seal["checks"]} & {"decrypted", "commitment"}, "what nobody could find out"
    assert seal["damaged"] == [1]
    assert seal["verdict_height"] is not None
    assert await desk.page.refused("GET", f"/api/clips/{opened['clip']}/frames/1/file") == "NOT_FOUND"
    row = (await desk.page.get("/api/records"))["records"][0]
    assert row["verdict"] == "corrupted"
    (alarm,) = (await desk.page.get("/api/inbox"))["alarms"]
    assert alarm["corrupted_records"] == [ids[0]]
    assert (await desk.page.get("/api/overview"))["counts"]["alarms"] == 1


async def test_a_seal_is_red_while_any_check_failed_and_so_says_the_verdict_on_the_chain(
    desk: PageHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The robot counted 5 pictures and committed to 1: what there is is whole, and still it is not verified."""
    miscounting(monkeypatch, 5)
    visit = desk.ward.open_visit()
    record_id = desk.ward.record(visit, frames=1)
    desk.ward.close_visit(visit)
    await desk.read()
    opened = await judged(desk, [record_id.hex()])
    (seal,) = opened["seals"]
    assert (seal["state"], seal["frames_ok"], seal["corrupted"]) == ("bad", 1, [])
    assert (seal["frames_counted"], seal["frames_committed"]) == (5, 1)
    assert [check["code"] for check in seal["checks"] if not check["ok"]] == ["complete"]
    on_chain = desk.ward.chain.value("access", b"verdict/" + record_id)
    assert (on_chain["verdict"], on_chain["frames"]) == ("corrupted", [])
    assert (await desk.page.get("/api/records"))["records"][0]["verdict"] == "corrupted"
    wish = {"records": [record_id.hex()], "frames": [1]}
    assert await desk.page.refused("POST", "/api/erasures/plan", wish) == "REQUEST_INVALID", "there is one picture"
    assert (await desk.page.post("/api/erasures/plan", wish | {"frames": [0]}))["records"] == [record_id.hex()]


async def test_a_clip_whose_empty_room_nobody_has_is_shown_without_it_and_says_why(desk: PageHarness) -> None:
    ids = await recorded(desk)
    desk.ward.custody.rooms.clear()
    opened = await desk.page.do("/api/clips", {"records": ids})
    clip = await desk.page.get(f"/api/clips/{opened['clip']}")
    (reason,) = clip["missing_rooms"]
    assert reason == {
        "code": "EMPTY_FRAME_WITHDRAWN",
        "sentence": "The empty frame was withdrawn: no robot may publish it any more.",
    }
    path = f"/api/clips/{opened['clip']}/frames/2/depth"
    assert await desk.page.get(path) == await desk.page.get(path, own=1)


async def test_of_a_robot_that_committed_to_another_picture_the_seal_blames_nobody_who_keeps_it(
    desk: PageHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    committing_otherwise(monkeypatch, 1)
    ids = await recorded(desk, 1)
    (seal,) = (await judged(desk, ids))["seals"]
    assert (seal["state"], seal["corrupted"], seal["damaged"]) == ("bad", [1], [])
    assert [check["sentence"] for check in seal["checks"] if not check["ok"]] == ["Not what the robot committed to: 2"]
    assert desk.ward.chain.value("access", b"verdict/" + bytes.fromhex(ids[0]))["frames"] == [1]


async def test_a_record_of_which_its_owner_erased_pictures_keeps_its_green_seal(desk: PageHarness) -> None:
    visit = desk.ward.open_visit()
    record_id = desk.ward.record(visit, frames=3)
    desk.ward.close_visit(visit)
    await desk.ward.erase(visit, [record_id], [1])
    clip = desk.ward.custody.clips[record_id]
    frames = list(clip.frames)
    frames[1] = msgspec.structs.replace(frames[1], erased=True, ciphertext=b"", sealed_key=b"")
    desk.ward.custody.clips[record_id] = msgspec.structs.replace(clip, frames=frames)
    await desk.read()
    (seal,) = (await judged(desk, [record_id.hex()]))["seals"]
    assert (seal["state"], seal["erased"], seal["frames_ok"]) == ("good", [1], 2)
    assert desk.ward.chain.value("access", b"verdict/" + record_id)["verdict"] == "verified"


async def test_what_a_seal_tells_is_in_the_language_that_the_page_asks_for(desk: PageHarness) -> None:
    ids = await recorded(desk)
    desk.ward.spoil(bytes.fromhex(ids[0]), 1)
    opened = await desk.page.do("/api/clips", {"records": ids})
    path = f"/api/clips/{opened['clip']}"
    told = {}
    for language in ("en", "pt"):
        desk.page.headers["Accept-Language"] = language
        told[language] = (await desk.page.get(path))["seals"][0]
    assert told["en"]["sentence"] == "1 of 2 pictures are as the robot took them. Did not pass every check: 2."
    assert (
        told["pt"]["sentence"] == "1 de 2 imagens estão como o robô as fez. Não passaram em todas as verificações: 2."
    )
    assert told["pt"]["checks"][0]["sentence"] == "O bloco está assinado por organizações suficientes da rede"
    assert told["pt"]["checks"][3]["sentence"] == "O que foi enviado não é o que o registo nomeia: 2"


async def test_how_many_tries_are_left_is_told_in_the_language_that_the_page_asks_for(desk: PageHarness) -> None:
    ids = await recorded(desk)
    desk.page.headers["Accept-Language"] = "pt"
    wanted = {"records": ids, "passphrase": "coffee"}
    told = [(await desk.page.ask("POST", "/api/erasures", wanted))[1]["detail"] for _ in range(5)]
    assert told[0] == "Essa não é a frase-passe. Restam 4 tentativas."
    assert told[3] == "Essa não é a frase-passe. Resta 1 tentativa."
    assert told[4] == "Essa não é a frase-passe. Espere 60 segundos antes de tentar outra vez."


async def test_records_of_two_visits_are_not_opened_together(desk: PageHarness) -> None:
    ids = [*(await recorded(desk)), *(await recorded(desk))]
    assert await desk.page.refused("POST", "/api/clips", {"records": ids}) == "REQUEST_INVALID"
    assert await desk.page.refused("POST", "/api/clips", {"records": []}) == "REQUEST_INVALID"


async def test_consent_is_given_only_under_the_notice_in_force(
    desk: PageHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def nobody_signs(*_: object, **__: object) -> bytes:
        raise BlockRobotError("CONSENT_RECEIPT_ELSEWHERE")

    monkeypatch.setattr(desk.ward.network, "ask_node", nobody_signs)
    consents = await desk.page.get("/api/consents")
    assert "own-access" not in consents["purposes"]
    wish = {"purposes": ["care"], "sensors": ["depth"], "notice_version": 7}
    job = await desk.page.follow(await desk.page.post("/api/consents/give", wish))
    assert job["error"]["code"] == "NOTICE_NOT_SHOWN"
    said = await desk.page.do("/api/consents/give", wish | {"notice_version": consents["notice"]["version"]})
    assert (said["status"], said["count"], said["receipt"]) == ("given", 1, None)
    assert "not here yet" in said["receipt_sentence"]
    taken = await desk.page.do("/api/consents/withdraw", {"purposes": [], "sensors": []})
    assert (taken["status"], taken["count"]) == ("withdrawn", 2)
    assert await desk.page.refused("POST", "/api/consents/give", wish | {"until_ms": 1}) == "REQUEST_INVALID"
    assert await desk.page.refused("POST", "/api/consents/refuse", {"purposes": []}) == "REQUEST_INVALID"


async def test_nobody_consents_on_the_page_to_what_the_notice_does_not_name(desk: PageHarness) -> None:
    kept = [purpose for purpose in demo_notice().purposes if purpose.code != "care"]
    notice = encode_notice(msgspec.structs.replace(demo_notice(), purposes=kept))
    desk.ward.chain.must(desk.ward.chain.admin, "consent", "publish_notice", notice)
    consents = await desk.page.get("/api/consents")
    assert "care" not in consents["askable"]
    assert consents["askable"], "the others are offered"
    assert "care" in consents["purposes"], "what she once agreed to she can take back"
    assert set(consents["purposes"]) == {*consents["askable"], *consents["grounds"], "care"}
    wish = {"purposes": ["care"], "sensors": ["depth"], "notice_version": 1}
    job = await desk.page.follow(await desk.page.post("/api/consents/give", wish))
    assert job["error"]["code"] == "PURPOSE_NOT_IN_NOTICE"


async def test_the_page_offers_no_consent_beyond_the_notice_and_tells_what_else_a_purpose_rests_on(
    desk: PageHarness,
) -> None:
    before = await desk.page.get("/api/consents")
    assert before["askable"]["safety"] == sorted(before["sensors"]), "nothing is published: she is told that"
    notice = encode_notice(demo_notice())
    desk.ward.chain.must(desk.ward.chain.admin, "consent", "publish_notice", notice)
    consents = await desk.page.get("/api/consents")
    assert consents["askable"]["safety"] == ["depth"]
    assert consents["askable"]["care"] == ["audio", "depth", "emotion", "rgb"]
    assert "audit" not in consents["askable"]
    assert consents["grounds"] == {"audit": "Art. 6(1)(c)"}
    assert "audit" in consents["purposes"], "she is told that it is done, and on what ground"
    for purpose, sensor, code in (("safety", "rgb", "SENSOR_NOT_IN_NOTICE"), ("audit", "depth", "CONSENT_NOT_ASKED")):
        wish = {"purposes": [purpose], "sensors": [sensor], "notice_version": 1}
        job = await desk.page.follow(await desk.page.post("/api/consents/give", wish))
        assert job["error"]["code"] == code
        refused = {"purposes": [purpose], "sensors": [sensor]}
        assert (await desk.page.do("/api/consents/refuse", refused))["status"] == "refused"


async def test_a_yes_lacks_depth_before_the_period_of_the_yes_to_depth_and_once_it_is_over(desk: PageHarness) -> None:
    chain, patient = desk.ward.chain, desk.ward.patient
    begins, ends = round_period(chain.time_ms + WEEK_MS, chain.time_ms + 2 * WEEK_MS)

    def give(sensor: str, *period: int) -> None:
        chain.must(patient.identity, "consent", "give", patient.handle, ["safety"], [sensor], *period, 0, chain.height)

    async def lacking() -> list[str]:
        choices = (await desk.page.get("/api/consents"))["choices"]
        return [each["sensor"] for each in choices if each["purpose"] == "safety" and each["lacks_depth"]]

    give("rgb", 0, 0)
    assert await lacking() == ["rgb"], "nothing was said of depth"
    give("depth", begins, ends)
    assert await lacking() == ["rgb"], "it has not begun"
    chain.time_ms = begins
    give("audio", 0, 0)
    assert await lacking() == []
    chain.time_ms = ends
    give("emotion", 0, 0)
    assert await lacking() == ["audio", "emotion", "rgb"], "it is over"


async def share(desk: PageHarness, ids: list[str]) -> dict[str, Any]:
    doctor = desk.ward.come_in("doctor", "staff")
    return {
        "records": ids,
        "with": doctor.store.content.handle.hex(),
        "name": "Dr Weber",
        "purpose": "care",
        "until_ms": desk.ward.chain.time_ms + WEEK_MS,
    }


async def test_a_records_story_tells_what_was_said_of_it_and_of_looks_at_several_that_they_were(
    desk: PageHarness,
) -> None:
    """Of a look the trail has only the number: each record of the share is told of it, as of one at several."""
    ids = await recorded(desk, 3)
    doctor = desk.ward.come_in("doctor", "staff")
    shared = await desk.ward.share(doctor)
    await desk.read()
    receiving = desk.ward.receiving(doctor)
    (receipt,) = await receiving.inbox()
    first_two = [bytes.fromhex(each) for each in ids[:2]]
    await receiving.request_access(receipt, first_two)
    await desk.page.do(f"/api/shares/{shared.grant_id.hex()}/revoke")
    (receipt,) = await receiving.inbox()
    await receiving.confirm_deleted(receipt, first_two)
    await desk.read()
    told = {}
    for place in (0, 2):
        events = (await desk.page.get(f"/api/records/{ids[place]}"))["events"]
        told[place] = {event["kind"]: event["sentence"] for event in events if event["who"] == "other"}
    looked = "Someone you shared with asked to look at 2 of the recordings that you shared together."
    assert told[2] == {"access_requested": looked}
    deleted = "Someone you shared with says that the copies of 2 recordings are deleted."
    assert told[0] == {"access_requested": looked, "grant_noticed": deleted}


async def test_sharing_tells_first_asks_for_the_passphrase_and_can_be_ended(desk: PageHarness) -> None:
    wish = await share(desk, await recorded(desk))
    plan = await desk.page.post("/api/shares/plan", wish)
    assert (plan["grantee"]["name"], plan["records"], plan["pictures"]) == ("Dr Weber", 2, 4)
    assert await desk.page.refused("POST", "/api/shares", wish) == "REQUEST_INVALID"
    done = await desk.page.do("/api/shares", wish | {"passphrase": PASSPHRASE})
    (made,) = done["shared"]
    (shown,) = (await desk.page.get("/api/shares"))["shares"]
    assert (shown["grant_id"], shown["status"], shown["name"]) == (made["grant_id"], "open", "Dr Weber")
    assert [row["shared"] for row in (await desk.page.get("/api/records"))["records"]] == [1, 1]
    whom = encode_short(bytes.fromhex(wish["with"]))
    for language, who in (("pt", f"Dr Weber (identificador {whom})"), ("en", f"Dr Weber (handle {whom})")):
        desk.page.headers["Accept-Language"] = language
        assert (await desk.page.get("/api/shares"))["shares"][0]["who"] == who
    await desk.page.do(f"/api/shares/{made['grant_id']}/revoke")
    (shown,) = (await desk.page.get("/api/shares"))["shares"]
    assert shown["status"] == "revoked"
    first = await desk.page.get(f"/api/records/{wish['records'][0]}")
    kinds = [event["kind"] for event in first["events"]]
    assert (kinds.count("granted"), kinds.count("grant_revoked")) == (1, 1), "that of several together is told of each"
    assert await desk.page.refused("POST", f"/api/shares/{'0' * 64}/revoke") == "NOT_FOUND"


async def test_a_wrong_passphrase_is_counted_locked_and_ends_the_page_at_last(desk: PageHarness) -> None:
    wish = await share(desk, await recorded(desk))
    codes = [await desk.page.refused("POST", "/api/shares", wish | {"passphrase": f"guess {n}"}) for n in range(6)]
    assert codes == ["WALLET_PASSPHRASE_WRONG"] * 4 + ["PASSPHRASE_LOCKED"] * 2
    assert await desk.page.refused("POST", "/api/shares", wish | {"passphrase": PASSPHRASE}) == "PASSPHRASE_LOCKED"
    assert desk.ward.wallet.store.content.given_grants == []
    for _ in range(5):
        desk.ward.chain.time_ms += 3_600_000
        assert not desk.session.ended.is_set()
        await desk.page.refused("POST", "/api/shares", wish | {"passphrase": "guess"})
    assert desk.session.ended.is_set()
    assert "10 wrong passphrases" in await serve_commands._wait_until_over(desk.session, 30)


async def test_a_clip_holds_no_more_than_its_limit_and_one_record(
    desk: PageHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    ids = await recorded(desk)
    assert (await desk.page.do("/api/clips", {"records": ids}))["records"] == len(ids)
    monkeypatch.setattr(clip_routes, "CLIP_MAX_BYTES", 1)
    opened = await desk.page.do("/api/clips", {"records": ids})
    assert (opened["records"], len(opened["seals"])) == (1, 1)
    await desk.page.do(f"/api/clips/{opened['clip']}/verdict")
    assert (await desk.page.get(f"/api/clips/{opened['clip']}"))["records"] == ids[:1]
    verdicts = [row["verdict"] for row in (await desk.page.get("/api/records"))["records"]]
    assert verdicts == ["verified", None], "what was not looked at is not called checked"


async def test_nobody_is_registered_with_a_damaged_code_or_without_the_passphrase(desk: PageHarness) -> None:
    assert await desk.page.refused("POST", "/api/registration/plan", {"code": "BR1-DAMAGED"}) == "VOUCHER_INVALID"
    code = encode_card_code(desk.ward.chain.card("bea"))
    wish = {"code": code, "organisation": "hospital", "notice_version": 0, "notice_hash": ""}
    assert await desk.page.refused("POST", "/api/registration", wish) == "REQUEST_INVALID"
    wrong = wish | {"passphrase": "coffee"}
    assert await desk.page.refused("POST", "/api/registration", wrong) == "WALLET_PASSPHRASE_WRONG"


async def test_a_clip_is_closed_once_the_chain_has_a_record_of_it_no_more(desk: PageHarness) -> None:
    ids = await recorded(desk)
    clip = (await desk.page.do("/api/clips", {"records": ids}))["clip"]
    await desk.read()
    await desk.page.get(f"/api/clips/{clip}")
    await ErasureClient(desk.session.wallet).request_each([desk.session.snapshot.entry(bytes.fromhex(ids[0]))], [])
    await desk.read()
    assert await desk.page.refused("GET", f"/api/clips/{clip}") == "CLIP_NOT_OPEN"


async def test_tasks_wait_for_each_other_and_can_be_stopped_while_they_change_nothing(desk: PageHarness) -> None:
    gate = asyncio.Event()

    async def work(job: Job) -> dict[str, Any]:
        job.tell("counting", 1, 3)
        await gate.wait()
        return {}

    first = desk.session.jobs.start("erase", work)
    second = desk.session.jobs.start("export", work, stoppable=True)
    seen = await desk.page.get(f"/api/jobs/{first.name}", after=1, wait_ms=5_000)
    assert (seen["step"], seen["done"], seen["of"], seen["stoppable"]) == ("counting", 1, 3, False)
    assert (await desk.page.get(f"/api/jobs/{second.name}"))["state"] == "waiting"
    assert await desk.page.refused("POST", f"/api/jobs/{first.name}/cancel") == "JOB_NOT_STOPPABLE"
    await desk.page.post(f"/api/jobs/{second.name}/cancel")
    assert (await desk.page.get(f"/api/jobs/{second.name}", wait_ms=5_000, after=99))["state"] == "cancelled"
    gate.set()
    assert (await desk.page.get(f"/api/jobs/{first.name}", wait_ms=5_000, after=99))["state"] == "done"
    assert await desk.page.refused("GET", "/api/jobs/nobody") == "NOT_FOUND"


async def test_a_page_that_ends_finishes_what_she_decided_and_stops_what_only_looks() -> None:
    gate, seen = asyncio.Event(), list[str]()

    async def read() -> None:
        seen.append("read")

    def make(name: str) -> Any:
        async def work(_: Job) -> dict[str, Any]:
            await gate.wait()
            seen.append(name)
            return {}

        return work

    jobs = Jobs(asyncio.Lock(), lambda: 0, read)
    kinds = ("export", "erase", "verify", "consent")
    started = [jobs.start(kind, make(kind), stoppable=kind == "export") for kind in kinds]
    await asyncio.sleep(0)
    assert started[0].state == "running"
    assert jobs.are_decisions_open
    ending = asyncio.create_task(jobs.close())
    await asyncio.sleep(0)
    gate.set()
    await ending
    assert seen == ["erase", "consent"]
    assert [job.state for job in started] == ["cancelled", "done", "cancelled", "done"]


async def test_a_page_that_is_locked_does_not_wait_for_receipts(desk: PageHarness) -> None:
    ids = await recorded(desk)
    desk.session.ended.set()
    done = await desk.page.do("/api/erasures", {"records": ids, "passphrase": PASSPHRASE})
    assert done["complete"] is False


async def test_everything_of_a_month_fits_into_one_wish(desk: PageHarness) -> None:
    ids = [f"{number:032x}" for number in range(IDS_MAX_COUNT)]
    assert await desk.page.refused("POST", "/api/erasures/plan", {"records": ids}) == "NOT_FOUND"
    assert await desk.page.refused("POST", "/api/erasures/plan", {"records": [*ids, "00"]}) == "REQUEST_INVALID"


async def test_a_task_that_is_done_is_not_stopped_while_the_lists_are_read_again(
    desk: PageHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    reading, gate = asyncio.Event(), asyncio.Event()

    async def read() -> None:
        reading.set()
        await gate.wait()

    async def work(_: Job) -> dict[str, Any]:
        return {"export": "7"}

    monkeypatch.setattr(desk.session.jobs, "_after", read)
    job = desk.session.jobs.start("export", work, stoppable=True)
    await reading.wait()
    assert await desk.page.refused("POST", f"/api/jobs/{job.name}/cancel") == "JOB_NOT_STOPPABLE"
    gate.set()
    assert (await desk.page.follow({"job": job.name}))["result"] == {"export": "7"}


async def test_a_question_says_so_if_the_wallet_is_busy_for_long(
    desk: PageHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sessions, "HOLD_MAX_S", 0.01)
    async with desk.session.lock:
        assert await desk.page.refused("GET", "/api/consents") == "WALLET_BUSY"


async def test_a_task_that_fails_says_why_and_what_to_do(desk: PageHarness, monkeypatch: pytest.MonkeyPatch) -> None:
    ids = await recorded(desk)

    async def fail(*_: object) -> None:
        raise BlockRobotError("NODE_UNREACHABLE", "None of the nodes answers.")

    monkeypatch.setattr(desk.session.wallet, "visit_mark", fail)
    job = await desk.page.follow(await desk.page.post("/api/clips", {"records": ids}))
    assert (job["state"], job["error"]["code"]) == ("failed", "NODE_UNREACHABLE")
    assert job["error"]["next_step"]
    assert (await desk.page.get("/api/overview"))["state"] == "unreachable"


async def test_an_idle_page_is_told_by_what_people_do_not_by_what_it_asks_by_itself(desk: PageHarness) -> None:
    await desk.page.get("/api/overview")
    desk.ward.chain.time_ms += 29 * 60_000
    assert not desk.session.is_idle(30)
    await desk.page.get("/api/changes")
    desk.ward.chain.time_ms += 2 * 60_000
    assert desk.session.is_idle(30)
    await desk.page.get("/api/days")
    assert not desk.session.is_idle(30)


async def test_news_that_the_page_fetches_by_itself_keep_it_open_for_nobody(desk: PageHarness) -> None:
    minute_ms = 60_000
    for quiet_minutes in range(1, 32):
        desk.ward.chain.time_ms += minute_ms
        desk.page.headers[QUIET_HEADER] = str(quiet_minutes * minute_ms)
        await desk.page.get("/api/overview")
        await desk.page.get("/api/days")
    assert desk.session.is_idle(30)
    desk.page.headers[QUIET_HEADER] = "500"
    await desk.page.get("/api/changes")
    assert not desk.session.is_idle(30), "who reads and scrolls is there"
    desk.ward.chain.time_ms += 31 * minute_ms
    desk.page.headers[QUIET_HEADER] = "-1"
    await desk.page.get("/api/changes")
    assert desk.session.is_idle(30)
