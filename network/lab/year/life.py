"""What people, robots, doctors and officers do when something of the plan happens: calls to the chain, clips, downloads."""

from __future__ import annotations

from collections import Counter
from collections.abc import AsyncGenerator, Callable, Sequence
from typing import Any

from consensus.chain.block import Receipt
from consensus.chain.transaction import Transaction
from consensus.limits import DAY_MS, TIME_BUCKET_MS
from consensus.members.vouchers import sign_rotation
from consensus.primitives.keys import PrivateKey
from consensus.records.envelopes import DATA_KEY_BYTES, NONCE_BYTES, open_data_key, open_frame
from consensus.records.owner_keys import VisitKeys, derive_owner_key, open_visit_keys, sign_transfer
from consensus.records.sharing import (
    GRANT_STEP_MS,
    GrantUpload,
    SharedRequest,
    count_masks,
    derive_grant_salt,
    derive_grantee_key,
    hash_grant_member,
    join_parts,
    open_grant_keys,
    open_package,
    seal_package,
    split_share_key,
)
from consensus.state.consent import CHOICES, effective_consent
from consensus.state.settings import read_quotas
from network.lab.year.chain import HospitalChain
from network.lab.year.custody import Custodians
from network.lab.year.people import PURPOSE, SENSOR, Person, Visit, make_person, seal_record
from network.lab.year.plan import Event, Kind, YearOptions
from network.sim.workload import make_material
from node.custody.uploads.upload_usage import UploadTerms

Story = AsyncGenerator[list[Transaction], list[Receipt]]
"""Yields calls, and is sent their receipts once the block that has them is followed by every custodian."""
RESEARCH, OWN_ACCESS = "research", "own-access"
DAY_QUOTA_MIB = 204_800


class Hospital:
    """Its people and what they know; `troubles` are sentences of what did not go as it should."""

    def __init__(self, options: YearOptions, chain: HospitalChain, custodians: Custodians) -> None:
        self._options, self._chain, self._custodians = options, chain, custodians
        self._registrar, self._admin = chain.chain.registrar, chain.chain.admins[0]
        seed = options.seed
        self.members = {number: self._make(f"member {number}") for number in range(options.members)}
        self.doctors = [make_person(seed, f"doctor {number}", "staff") for number in range(options.staff)]
        self.officer = make_person(seed, "officer", "officer")
        self.robots = [make_person(seed, f"robot {number}", "robot") for number in range(options.robots)]
        self._robots_count = options.robots
        self.visits: dict[int, Visit] = {}
        self.grants: dict[int, tuple[Visit, bytes]] = {}
        self.counts: Counter[str] = Counter()
        self.troubles: list[str] = []
        self.recorded_today: list[bytes] = []
        self.erase_soon: Callable[[list[bytes]], None] = lambda _record_ids: None
        """Told of records before their erasure is asked for."""

    def _make(self, name: str) -> Person:
        return make_person(self._options.seed, name, "subject")

    def _draw(self, size: int, *parts: Any) -> bytes:
        return make_material(size, self._options.seed, *parts)

    def tell(self, event: Event) -> Story:
        return _STORIES[event.kind](self, event)

    def registrations(self) -> list[Transaction]:
        """Of everybody who is there at the beginning."""
        return [
            self._register(person) for person in (*self.robots, *self.doctors, self.officer, *self.members.values())
        ]

    def _register(self, person: Person) -> Transaction:
        arguments = person.register_arguments(self._chain.chain_id, self._registrar, self._chain.now_ms)
        return self._chain.sign(person.keys.identity, "identity", "register", *arguments)

    def _bucket_ms(self) -> int:
        return self._chain.now_ms - self._chain.now_ms % TIME_BUCKET_MS

    def _ids(self, event: Event) -> tuple[Visit, list[bytes]]:
        visit = self.visits[event.subject]
        return visit, [visit.record_ids[index] for index in event.records]

    def _by_owner(self, visit: Visit, contract: str, entry: str, *arguments: Any) -> Transaction:
        return self._chain.sign(visit.key, contract, entry, *arguments)

    # Visits

    def _consents(self, person: Person) -> bool:
        """As a robot reads it: by what the chain says now."""
        with self._chain.store.snapshot() as snapshot:
            steps = (CHOICES.at(snapshot, person.handle) or {}).get(PURPOSE, {}).get(SENSOR, [])
        return effective_consent(steps, self._chain.height) is not None

    def _terms(self, robot: Person) -> UploadTerms:
        with self._chain.store.snapshot() as snapshot:
            quotas = read_quotas(snapshot.get)
        organisation = self._chain.genesis.organisations[0].name
        return UploadTerms(
            robot.keys.identity.public_key, quotas, lambda _robot: organisation, lambda _robot: robot.handle
        )

    def _new_owner_keys(self, person: Person, robot: bytes, *place: Any) -> tuple[VisitKeys, PrivateKey]:
        keys, chain_id = person.keys, self._chain.chain_id
        secret = self._draw(32, "ephemeral", *place)
        made = open_visit_keys(secret, keys.view.public_key, keys.spend.public_key, chain_id=chain_id, robot=robot)
        return made, derive_owner_key(keys.spend, keys.view, made.ephemeral, chain_id=chain_id, robot=robot)

    async def visit(self, event: Event) -> Story:
        number, robot_number, kept_days, *frames = event.subject, *event.amounts[1:]
        person, robot = self.members[event.amounts[0]], self.robots[robot_number]
        if self._consents(person) != bool(frames):
            self.troubles.append(f"the plan and the chain differ on whether {person.name} consents")
        if not frames:
            self.counts["people met who consent to nothing"] += 1
            return
        signer = robot.keys.identity
        made, key = self._new_owner_keys(person, signer.public_key, "visit", number)
        visit = Visit(number, person, signer.public_key, made.owner, key, person.keys.sealing)
        bucket_ms, expires_ms = self._bucket_ms(), self._bucket_ms() + kept_days * DAY_MS
        opened = [made.owner, made.ephemeral, made.view_tag, bucket_ms, PURPOSE]
        yield [self._chain.sign(signer, "records", "open_visit", *opened)]
        self.visits[number] = visit
        person.visits.append(visit)
        calls, previous, terms = [], bytes(32), self._terms(robot)
        for index, many in enumerate(frames):
            sealed = seal_record(visit, person.keys.sealing_public, many, self._chain.now_ms, index, previous)
            previous = sealed.metadata_hash
            words = [sealed.upload.record_id, visit.owner, sealed.commitment_root, sealed.ciphertext_root]
            call = self._chain.sign(signer, "records", "record", *words, sealed.sealed_metadata, bucket_ms, expires_ms)
            await self._custodians.stage(sealed.sent_by(call), terms)
            visit.record_ids.append(sealed.upload.record_id)
            visit.plaintexts[sealed.upload.record_id] = sealed.plaintexts
            calls.append(call)
        self.recorded_today += visit.record_ids
        yield calls
        yield [self._chain.sign(signer, "records", "close_visit", visit.owner, len(frames))]
        visit.trail.update({"visit_opened": 1, "recorded": len(frames), "visit_closed": 1})
        self.counts.update({"visits": 1, "records": len(frames), "frames": sum(frames)})

    # What owners ask for

    async def _open(self, visit: Visit, record_ids: Sequence[bytes], access_id: bytes) -> dict[bytes, dict[int, bytes]]:
        """Download from one custodian, decrypt and compare; return the data keys."""
        place = self._custodians.places[visit.number % len(self._custodians.places)]
        found: dict[bytes, dict[int, bytes]] = {}
        for record_id in record_ids:
            clip = await place.custodian.download(record_id, access_id, visit.owner)
            for frame in (each for each in clip.frames if not each.erased):
                data_key = open_data_key(visit.sealing, frame.sealed_key)
                plaintext = open_frame(data_key, record_id, frame.index, frame.ciphertext)
                if plaintext != visit.plaintexts[record_id][frame.index]:
                    self.troubles.append(f"frame {frame.index} of {record_id.hex()} is not what was recorded")
                found.setdefault(record_id, {})[frame.index] = data_key
        self.counts["frames opened by their owners"] += sum(map(len, found.values()))
        return found

    def _note_release(self, visit: Visit) -> None:
        visit.trail.update({"access_requested": 1, "access_released": len(self._custodians.places)})

    async def look(self, event: Event) -> Story:
        visit, ids = self._ids(event)
        asked = self._by_owner(visit, "access", "request", ids, OWN_ACCESS)
        yield [asked]
        await self._open(visit, ids, asked.txid)
        yield [self._by_owner(visit, "access", "verdict", [[record_id, "verified", []] for record_id in ids])]
        self._note_release(visit)
        visit.trail["verdict"] += 1
        self.counts["looks"] += 1

    async def share(self, event: Event) -> Story:
        visit, ids = self._ids(event)
        doctor_number, days, number = event.amounts
        doctor, chain_id = self.doctors[doctor_number], self._chain.chain_id
        asked = self._by_owner(visit, "access", "request", ids, OWN_ACCESS)
        yield [asked]
        keys = await self._open(visit, ids, asked.txid)
        ephemeral = PrivateKey(self._draw(32, "grant", number))
        public = (doctor.keys.view.public_key, doctor.keys.spend.public_key)
        made = open_grant_keys(ephemeral.secret, *public, chain_id=chain_id, owner=visit.owner)
        salt = derive_grant_salt(ephemeral, public[0], chain_id=chain_id, owner=visit.owner)
        until_ms = self._chain.now_ms + days * DAY_MS
        words = [made.owner, made.ephemeral, made.view_tag, hash_grant_member(salt, doctor.handle), PURPOSE]
        grant = self._by_owner(visit, "access", "grant", ids, *words, until_ms - until_ms % GRANT_STEP_MS)
        for record_id in ids:
            await self._stage_parts(visit, record_id, doctor, grant, made.owner, keys[record_id], number)
        yield [grant]
        self.grants[number] = (visit, grant.txid)
        grantee = derive_grantee_key(
            doctor.keys.spend, doctor.keys.view, made.ephemeral, chain_id=chain_id, owner=visit.owner
        )
        request = self._chain.sign(grantee, "access", "request_granted", grant.txid, ids, PURPOSE)
        yield [request]
        for record_id in ids:
            wanted = SharedRequest(record_id, request.txid, doctor.handle, salt, with_frames=True)
            held = {}
            for place in self._custodians.places:
                shared = await place.custodian.download_shared(wanted, grant.txid)
                held[shared.custodian] = shared.parts
            opened = open_package(
                join_parts(held), doctor.keys.sealing, shared.package, grantee=made.owner, record_id=record_id
            )
            if opened != keys[record_id]:
                self.troubles.append(f"{doctor.name} was not given the keys of {record_id.hex()}")
        self._note_release(visit)
        self._note_release(visit)
        visit.trail["granted"] += 1
        self.counts["shares"] += 1

    async def _stage_parts(
        self,
        visit: Visit,
        record_id: bytes,
        doctor: Person,
        grant: Transaction,
        grantee: bytes,
        keys: dict[int, bytes],
        number: int,
    ) -> None:
        place = ("share", number, record_id.hex())
        members = sorted(each.key.public_key for each in self._custodians.places)
        share_key = self._draw(DATA_KEY_BYTES, *place)
        masks = [self._draw(DATA_KEY_BYTES, *place, mask) for mask in range(count_masks(len(members)))]
        nonce, sealing = self._draw(NONCE_BYTES, *place, "nonce"), doctor.keys.sealing_public
        package = seal_package(share_key, nonce, sealing, grantee=grantee, record_id=record_id, keys=keys)
        parts = split_share_key(share_key, members, masks)
        for each in self._custodians.places:
            own = parts[each.key.public_key]
            upload = GrantUpload(grant.txid, grant.body.valid_until_ms, record_id, package, own)
            await each.custodian.stage_part(upload, visit.owner)

    async def revoke_grant(self, event: Event) -> Story:
        visit, grant_id = self.grants.pop(event.subject)
        yield [self._by_owner(visit, "access", "revoke", grant_id)]
        visit.trail["grant_revoked"] += 1
        self.counts["shares ended early"] += 1

    def _note_erasure(self, visit: Visit) -> None:
        custodians = len(self._custodians.places)
        visit.trail.update({"erasure_requested": 1, "erasure_receipted": custodians, "erasure_complete": 1})

    async def erase(self, event: Event) -> Story:
        visit, ids = self._ids(event)
        self.erase_soon(ids)
        yield [self._by_owner(visit, "erasure", "request", ids, [])]
        self._note_erasure(visit)
        self.counts.update({"erasures asked for": 1, "records erased": len(ids)})

    async def erase_frame(self, event: Event) -> Story:
        visit, ids = self._ids(event)
        yield [self._by_owner(visit, "erasure", "request", ids, list(event.amounts))]
        self._note_erasure(visit)
        self.counts.update({"erasures asked for": 1, "single frames erased": 1})

    async def restrict(self, event: Event) -> Story:
        visit = self.visits[event.subject]
        yield [self._by_owner(visit, "rights", "restrict", [], "legal-claim")]
        visit.trail["restricted"] += 1
        self.counts["restrictions"] += 1

    async def lift(self, event: Event) -> Story:
        visit = self.visits[event.subject]
        yield [self._by_owner(visit, "rights", "lift", [])]
        visit.trail["restriction_lifted"] += 1
        self.counts["restrictions lifted"] += 1

    async def object(self, event: Event) -> Story:
        visit = self.visits[event.subject]
        yield [self._by_owner(visit, "rights", "object_to_release", [RESEARCH])]
        visit.trail["objected"] += 1
        self.counts["objections"] += 1

    async def deny(self, event: Event) -> Story:
        """The visit is somebody else's, says its owner; an officer has it erased."""
        visit, ids = self._ids(event)
        self.erase_soon(ids)
        denied = self._by_owner(visit, "rights", "wrong_person")
        yield [denied]
        officer = self.officer.keys.identity
        assessed = self._chain.sign(officer, "rights", "assess", denied.txid, "none", "tag-of-another")
        yield [assessed, self._chain.sign(officer, "rights", "order_erasure", denied.txid, ids)]
        yield [self._chain.sign(officer, "rights", "close", denied.txid, "erased", "tag-of-another")]
        visit.trail.update({"denied": 1, "breach_assessed": 1, "breach_closed": 1})
        self._note_erasure(visit)
        self.counts.update({"visits denied": 1, "erasures asked for": 1, "records erased": len(ids)})

    # Members, robots, settings

    async def withdraw(self, event: Event) -> Story:
        person = self.members[event.subject]
        yield [self._chain.sign(person.keys.identity, "consent", "withdraw", person.handle, [PURPOSE], [])]
        self.counts["consents withdrawn"] += 1

    async def give(self, event: Event) -> Story:
        person, seen = self.members[event.subject], self._chain.height
        words = [person.handle, [PURPOSE], [SENSOR], 0, 0, 0, seen]
        yield [self._chain.sign(person.keys.identity, "consent", "give", *words)]
        self.counts["consents given again"] += 1

    async def arrive(self, event: Event) -> Story:
        person = self.members[event.subject] = self._make(f"member {event.subject}")
        yield [self._register(person)]
        self.counts["arrivals"] += 1

    async def leave(self, event: Event) -> Story:
        person = self.members.pop(event.subject)
        yield [self._chain.sign(person.keys.identity, "identity", "leave", person.handle)]
        self.counts["departures"] += 1

    async def revoke_member(self, event: Event) -> Story:
        person = self.members.pop(event.subject)
        yield [self._chain.sign(self._registrar, "identity", "revoke", person.handle)]
        self.counts["members revoked"] += 1

    async def rotate(self, event: Event) -> Story:
        """New words: first the member's keys, then the owner key of each visit."""
        person, chain_id = self.members[event.subject], self._chain.chain_id
        old, new = person.keys, person.take_new_keys()
        public = (new.spend.public_key, new.view.public_key, new.sealing_public)
        agreed = sign_rotation(
            new.identity,
            chain_id=chain_id,
            handle=person.handle,
            member=old.identity.public_key,
            spend=public[0],
            view=public[1],
            sealing=public[2],
        )
        words = [person.handle, new.identity.public_key, *public, agreed]
        yield [self._chain.sign(old.identity, "identity", "rotate", *words)]
        calls = []
        for visit in person.visits:
            made, key = self._new_owner_keys(person, visit.robot, "transfer", visit.number, len(person.eras))
            signature = sign_transfer(key, chain_id=chain_id, root=visit.owner)
            announced = [made.owner, made.ephemeral, made.view_tag, signature]
            calls.append(self._by_owner(visit, "records", "transfer", *announced))
            visit.key = key
            visit.trail["transferred"] += 1
        if calls:
            yield calls
        self.counts.update({"keys rotated": 1, "visits moved to new keys": len(calls)})

    async def replace_robot(self, event: Event) -> Story:
        old, number = self.robots[event.subject], self._robots_count
        self._robots_count += 1
        new = self.robots[event.subject] = make_person(self._options.seed, f"robot {number}", "robot")
        yield [self._chain.sign(self._registrar, "identity", "revoke", old.handle), self._register(new)]
        self.counts["robots replaced"] += 1

    async def setting(self, event: Event) -> Story:
        value = DAY_QUOTA_MIB + event.subject
        yield [self._chain.sign(self._admin, "settings", "propose", "robot_day_max_mib", value)]
        self.counts["settings changed"] += 1


_STORIES: dict[Kind, Callable[[Hospital, Event], Story]] = {
    "visit": Hospital.visit,
    "look": Hospital.look,
    "share": Hospital.share,
    "revoke_grant": Hospital.revoke_grant,
    "erase": Hospital.erase,
    "erase_frame": Hospital.erase_frame,
    "restrict": Hospital.restrict,
    "lift": Hospital.lift,
    "object": Hospital.object,
    "deny": Hospital.deny,
    "withdraw": Hospital.withdraw,
    "give": Hospital.give,
    "arrive": Hospital.arrive,
    "leave": Hospital.leave,
    "revoke_member": Hospital.revoke_member,
    "rotate": Hospital.rotate,
    "replace_robot": Hospital.replace_robot,
    "setting": Hospital.setting,
}
