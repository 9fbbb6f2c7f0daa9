"""`blockrobot notice`: an organisation's notice to people, and its register of processing."""

from __future__ import annotations

import shlex
from pathlib import Path

import click
import msgspec

from clients.sdk.chain.governance import read_membership
from clients.sdk.chain.notices import read_notice, read_version
from clients.sdk.network_client import NetworkClient
from clients.sdk.new_files import read_given_file, write_new_file
from clients.sdk.terminal.json_answers import extend
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import EXISTING_FILE, FILE, ask, can_ask, command_output, console, print_answer
from consensus.bounded_text import TOML_MAX_BYTES, TextInvalidError, read_toml_text
from consensus.errors import BlockRobotError
from consensus.rights.notices import (
    Notice,
    NoticePurpose,
    NoticeVersion,
    Party,
    PublishedNotice,
    change_lines,
    encode_notice,
    notice_digest,
    notice_from,
    notice_lines,
)
from consensus.state import identity
from consensus.visible_text import split_lines
from network.cli.cluster.cluster_options import folder_option
from network.cli.governance.governance_answers import (
    DataCategory,
    DataRecipient,
    DataRetention,
    NoticeActivitiesAnswer,
    NoticeCheckAnswer,
    NoticeNewAnswer,
    NoticeParty,
    NoticePublishAnswer,
    NoticeReference,
    NoticeShowAnswer,
    NoticeVersionAnswer,
    ProcessingActivity,
    ProcessingPlace,
)
from network.cli.governance.governance_signer import (
    AdminOptions,
    Signer,
    governing_options,
    shown_id,
    with_client,
)
from network.notices.notice_publishing import DEMO_ORGANISATION, demo_notice_text, publish_notice
from network.notices.processing_register import OPEN, SUBJECTS, Activities, activities_text, read_activities
from pages.time_format import format_time


@click.group()
def notice() -> None:
    """What people are told before anything is recorded of them (GDPR, Articles 13 and 14), and the register of Article 30.

    Example: blockrobot notice publish notice.toml --as hospital
    """


def read_notice_file(path: Path) -> Notice:
    """From TOML. Raises NOTICE_INVALID."""
    data = read_given_file(path, TOML_MAX_BYTES)
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise BlockRobotError("NOTICE_INVALID", f"{path} is no text: line {line} is not UTF-8.") from None
    try:
        return notice_from(read_toml_text(text))
    except TextInvalidError as error:
        last = f"at line {len(split_lines(text))}, the last one: is the file whole?"
        detail = str(error).replace("at end of document", last)
        raise BlockRobotError("NOTICE_INVALID", f"{path} is no TOML file: {detail}.") from None


@notice.command()
@click.argument("file", type=FILE)
@command_output
def new(file: Path, as_json: bool) -> None:
    """Write the demonstration hospital's notice to FILE, to be changed into your own.

    Example: blockrobot notice new notice.toml
    """
    write_new_file(file, demo_notice_text(), private=False)
    if as_json:
        print_answer(NoticeNewAnswer(file=str(file)))
        return
    console.print(
        f"The demonstration's notice is in {escape(str(file))}. Change every line of it; have your data protection "
        f"officer read it.\nNext step: blockrobot notice check {escape(shlex.quote(str(file)))}"
    )


@notice.command()
@click.argument("file", type=EXISTING_FILE)
@command_output
def check(file: Path, as_json: bool) -> None:
    """Check that a notice says all that has to be said, and show it as people will read it.

    Example: blockrobot notice check notice.toml
    """
    found = read_notice_file(file)
    document = encode_notice(found)
    if as_json:
        print_answer(NoticeCheckAnswer(hash=notice_digest(document).hex(), bytes=len(document)))
        return
    for line in notice_lines(found):
        console.print(escape(line))
    console.print(
        f"\nIt is complete ({len(document)} bytes). Whether it is true, and lawful, no program can tell.\n"
        f"Next step: blockrobot notice publish {escape(shlex.quote(str(file)))} --as ORG"
    )


def _version_answer(row: NoticeVersion) -> NoticeVersionAnswer:
    return NoticeVersionAnswer(
        organisation=row.organisation, version=row.version, hash=row.digest.hex(), height=row.height
    )


async def _own_organisation(client: NetworkClient, signer: Signer) -> str:
    name = await client.state_value(identity.ADMIN.key(signer.key.public_key), signer.key)
    if not isinstance(name, str):
        raise BlockRobotError("GOVERNANCE_NOT_ADMIN")
    return name


def _ask_to_publish(organisation: str, before: PublishedNotice | None, found: Notice, *, yes: bool) -> None:
    if yes or (before is not None and before.notice == found):
        return
    lines = notice_lines(found) if before is None else change_lines(before.notice, found)
    for line in lines:
        click.echo(line, err=True)
    version = 1 if before is None else before.row.version + 1
    click.echo(f"\nThis is what {organisation} tells people as version {version}. It stays for ever.", err=True)
    ask("Publish it?", err=True)


@notice.command()
@click.argument("file", type=EXISTING_FILE)
@click.option("--yes", is_flag=True, help="Do not ask.")
@governing_options
@command_output
def publish(file: Path, yes: bool, admin: AdminOptions, as_json: bool) -> None:
    """Publish a notice as the next version of what your organisation tells people. It stays on the chain for ever.

    It shows what changes, and asks. Wallets show it before anybody registers, and tell those who are registered that it
    changed. It ends no consent: if what you do changes, ask people again.

    Example: blockrobot notice publish notice.toml --as hospital
    """
    found = read_notice_file(file)
    encode_notice(found)
    if not yes and not can_ask():
        raise click.UsageError("There is no terminal to ask for confirmation: give --yes.")
    signer = admin.signer()

    async def work(client: NetworkClient) -> tuple[PublishedNotice, bool]:
        name = signer.name or await _own_organisation(client, signer)
        _ask_to_publish(name, await read_notice(client, name), found, yes=yes)
        return await publish_notice(client, signer.key, name, found)

    published, is_new = with_client(signer, work)
    row = published.row
    if as_json:
        print_answer(extend(NoticePublishAnswer, _version_answer(row), is_new=is_new))
        return
    state = "is published" if is_new else "was in force already"
    console.print(
        f"Version {row.version} of what {escape(row.organisation)} tells people {state}, since block {row.height} "
        f"(hash {shown_id(row.digest)}).\nWhoever consented under an earlier one is told by their wallet what changed."
    )


@notice.command()
@click.argument("organisation", default=DEMO_ORGANISATION)
@click.option("--version", type=click.IntRange(min=1), help="An earlier version.")
@folder_option
@command_output
def show(organisation: str, version: int | None, folder: Path | None, as_json: bool) -> None:
    """Show what an organisation tells people, proved against the chain.

    Example: blockrobot notice show hospital --version 1
    """

    async def read(client: NetworkClient, _: object) -> PublishedNotice | None:
        return await (
            read_notice(client, organisation) if version is None else read_version(client, organisation, version)
        )

    found = AdminOptions(folder).read(read)
    if found is None:
        raise BlockRobotError("NOTICE_NOT_FOUND", f"{organisation} has published none.")
    row = found.row
    if as_json:
        answer = _version_answer(row)
        print_answer(extend(NoticeShowAnswer, answer, time_ms=row.time_ms, lines=notice_lines(found.notice)))
        return
    console.print(f"Version {row.version}, of {format_time(row.time_ms)}, block {row.height}:")
    for line in notice_lines(found.notice):
        console.print(escape(line))


def _party_answer(party: Party) -> NoticeParty:
    return NoticeParty(name=party.name, address=party.address, contact=party.contact)


def _activity_answer(purpose: NoticePurpose) -> ProcessingActivity:
    return ProcessingActivity(
        name=purpose.code,
        purpose=purpose.words,
        lawful_basis=purpose.lawful_basis,
        special_basis=purpose.special_basis,
        sensors=list(purpose.sensors),
        storage_days=purpose.storage_days,
    )


def activities_answer(found: Activities, file: Path | None) -> NoticeActivitiesAnswer:
    answer, row = found.notice, found.published.row
    return NoticeActivitiesAnswer(
        organisation=row.organisation,
        height=found.height,
        time_ms=found.time_ms,
        notice=NoticeReference(version=row.version, hash=row.digest.hex()),
        controller=_party_answer(answer.controller),
        joint_controllers=[_party_answer(each) for each in answer.joint_controllers],
        officer=_party_answer(answer.officer),
        activities=[_activity_answer(purpose) for purpose in answer.purposes],
        data_subjects=list(SUBJECTS),
        categories=[DataCategory(what=each.what, from_=each.origin) for each in answer.categories],
        recipients=[DataRecipient(who=each.who, what=each.what, why=each.why) for each in answer.recipients],
        other_keepers=list(found.processors),
        third_countries=answer.third_countries,
        retention=[DataRetention(what=each.what, how_long=each.how_long) for each in answer.retention],
        measures=list(answer.measures),
        places=[msgspec.convert(place, ProcessingPlace, from_attributes=True) for place in found.places],
        open=list(OPEN),
        file=None if file is None else str(file),
    )


@notice.command()
@click.option("--out", type=FILE, help="Write it to this new file, as Markdown.")
@governing_options
@command_output
def activities(out: Path | None, admin: AdminOptions, as_json: bool) -> None:
    """Make the register of processing activities (GDPR Art. 30) from the chain and the notice in force.

    What no program knows of your organisation it names as open: a register is kept by people.

    Example: blockrobot notice activities --as hospital --out register.md
    """
    signer = admin.signer()

    async def read(client: NetworkClient) -> Activities:
        name = signer.name or await _own_organisation(client, signer)
        return await read_activities(client, name, await read_membership(client, signer.key))

    found = with_client(signer, read)
    if out is not None:
        write_new_file(out, activities_text(found))
    if as_json:
        print_answer(activities_answer(found, out))
    elif out is not None:
        console.print(
            f"The register is in {escape(str(out))}, as of block {found.height}. Fill in what it names as open."
        )
    else:
        click.echo(activities_text(found), nl=False)
