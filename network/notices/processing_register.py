"""The Art. 30 register of processing activities, from chain and notice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from clients.sdk.chain.governance import MembershipView
from clients.sdk.chain.notices import read_notice
from clients.sdk.network_client import NetworkClient
from consensus.errors import BlockRobotError
from consensus.rights.notices import Notice, PublishedNotice
from pages.time_format import format_utc_time

OPEN = (
    "Representative in the Union, if the controller is not established there: Art. 30(1)(a).",
    "Whether the recipients outside of the network, such as authorities, are all named: Art. 30(1)(d).",
    "In which country each node stands, and on what ground data would go elsewhere: Art. 30(1)(e). "
    "The chain knows addresses, not countries.",
    "Measures outside of the programs: rooms, people, contracts, training: Art. 30(1)(g) and 32.",
    "What else the controller does with personal data: this register has only what robots and this network do.",
)


@dataclass(frozen=True, slots=True)
class Place:
    """A node: operator, address, and whether it keeps clips."""

    name: str
    organisation: str
    address: str
    keeps_clips: bool


@dataclass(frozen=True, slots=True)
class Activities:
    """One organisation's register as of one block."""

    published: PublishedNotice
    height: int
    time_ms: int
    organisations: tuple[str, ...]
    places: tuple[Place, ...]

    @property
    def notice(self) -> Notice:
        return self.published.notice

    @property
    def processors(self) -> tuple[str, ...]:
        """Return other organisations whose nodes keep recordings: joint controllers or processors, by contract."""
        own = self.published.row.organisation
        return tuple(sorted({place.organisation for place in self.places if place.keeps_clips} - {own}))


SUBJECTS = (
    "Patients and visitors who carry a tag and consented (role subject).",
    "Staff who carry a tag and consented (role staff).",
    "Officers, auditors, registrars and admins: their keys and what they sign.",
    "Bystanders: seen by the robot for seconds, cut out before anything is kept.",
)


async def read_activities(client: NetworkClient, organisation: str, membership: MembershipView) -> Activities:
    """Proved. Raises NOTICE_NOT_FOUND without a notice."""
    published = await read_notice(client, organisation)
    if published is None:
        raise BlockRobotError("NOTICE_NOT_FOUND", f"{organisation} has published none, and the register rests on it.")
    places = tuple(
        Place(node.name, node.organisation, node.api_url, bool(node.custodian_key)) for node in membership.nodes
    )
    names = tuple(row.name for row in membership.organisations)
    return Activities(published, membership.height, membership.timestamp_ms, names, places)


def _on_one_line(text: str) -> str:
    """Return text on one line, since further lines could inject Markdown headings or rows."""
    return " ".join(text.split())


def _table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> list[str]:
    def line(cells: tuple[str, ...]) -> str:
        return "| " + " | ".join(_on_one_line(cell).replace("|", "\\|") for cell in cells) + " |"

    return [line(head), line(("---",) * len(head)), *map(line, rows), ""]


def activities_text(found: Activities) -> str:
    notice, row = found.notice, found.published.row
    when = format_utc_time(found.time_ms)
    lines = [
        f"# Register of processing activities: {_on_one_line(notice.controller.name)}",
        "",
        f"Art. 30(1) GDPR, for what robots record and this network keeps. Made from the chain as of block {found.height} "
        f"({when}) and from version {row.version} of the privacy notice of {row.organisation} (hash {row.digest.hex()}).",
        "",
        "## (a) Who is responsible",
        "",
    ]
    parties = [("Controller", notice.controller), *(("Joint controller", each) for each in notice.joint_controllers)]
    parties.append(("Data protection officer", notice.officer))
    rows = [(role, party.name, party.address, party.contact) for role, party in parties]
    lines += _table(("role", "name", "address", "contact"), rows)
    lines += ["## (b) Purposes", ""]
    lines += _table(
        ("activity", "purpose", "ground", "ground for special categories", "sensors", "kept"),
        [
            (
                each.code,
                each.words,
                each.lawful_basis,
                each.special_basis,
                ", ".join(each.sensors) or "none",
                f"{each.storage_days} days" if each.storage_days else "not recorded for this",
            )
            for each in notice.purposes
        ],
    )
    lines += ["## (c) Data subjects and categories of data", "", *(f"- {subject}" for subject in SUBJECTS), ""]
    lines += _table(("data", "from"), [(each.what, each.origin) for each in notice.categories])
    lines += ["## (d) Recipients", ""]
    lines += _table(("who", "what", "why"), [(each.who, each.what, each.why) for each in notice.recipients])
    others = ", ".join(found.processors) or "none"
    lines += [f"Other organisations whose nodes keep encrypted clips, by the chain: {others}.", ""]
    lines += ["## (e) Third countries", "", _on_one_line(notice.third_countries), ""]
    lines += ["## (f) Time limits for erasure", ""]
    lines += _table(("what", "how long"), [(each.what, each.how_long) for each in notice.retention])
    lines += ["## (g) Measures", "", *(f"- {_on_one_line(measure)}" for measure in notice.measures), ""]
    lines += ["## Where it is processed", ""]
    keeps = {True: "ledger and encrypted clips", False: "ledger"}
    lines += _table(
        ("node", "organisation", "address", "keeps"),
        [(each.name, each.organisation, each.address, keeps[each.keeps_clips]) for each in found.places],
    )
    lines += ["## Open: what no program knows", "", *(f"- {each}" for each in OPEN)]
    return "\n".join(lines) + "\n"
