// Settings and proposals: by which numbers the chain runs, and what organisations are deciding.

import { h } from "./shared/dom.js";
import { plural } from "./shared/format.js";
import { api, objectOf } from "./api.js";
import { Bytes } from "./msgpack.js";
import { badge, card, facts, go, hex, moment, number, problemView, sheet, table, valueView } from "./pieces.js";

const MEANINGS = {
  production: ["when blocks are made", "On demand: as soon as there is work. At an interval: with or without."],
  heartbeat_ms: ["an empty block after", "After so long without work an empty block is made, so that silence means something."],
  min_block_interval_ms: ["least time between blocks", "No two blocks are closer together."],
  max_clock_drift_ms: ["how far clocks may be ahead", "A block's time may be so far ahead of the clock of a node that votes for it."],
  base_timeout_ms: ["patience with a leader, at first", "So long producers wait for a leader before they give its round up."],
  timeout_cap_ms: ["patience with a leader, at most", "The wait grows while rounds go on failing, up to this."],
  blocks_per_turn: ["rounds of one leader in a row", "After so many the next producer leads."],
  max_producers: ["seats, at most", "More producers than these take no part at once."],
};

function exactTime(ms) {
  return ms < 1000 ? `${number(ms)} ms` : `${number(ms / 1000)} s`;
}

/** A setting with its unit, what it is for, and the name under which it is changed. */
function settingFact([name, value]) {
  const [words, meaning] = MEANINGS[name] ?? [name, ""];
  const shown = name.endsWith("_ms") ? exactTime(Number(value)) : typeof value === "number" ? number(value) : String(value);
  return [words, shown, [meaning, h("div", { class: "mono" }, `${name} = ${value}`)]];
}

export async function governancePage() {
  const [settings, open, organisations, { due }] = await Promise.all([api.view("settings", "in_force"), api.view("membership", "proposals"), api.view("membership", "active_organisations"), api.contracts()]);
  const proposals = await Promise.all(open.map(async ([id, organisation, expiresMs]) => ({ id: id.hex, organisation, expiresMs, entry: objectOf(await api.view("membership", "proposal", id)) })));
  const rows = proposals.map((one) => [go(`proposal/${one.id}`, hex(one.id)), h("span", { class: "mono" }, `${one.entry.contract}: ${one.entry.kind}`), one.organisation, voices(one.entry).join(", "), moment(one.expiresMs)]);
  return sheet("Governance",
    `What holds for all is decided by the ${plural(organisations.length, "organisation", "organisations")} together: one proposes, and once a majority approves it takes effect. Settings change at the end of an epoch, in one block for all nodes.`,
    card("Settings in force", facts([...Object.keys(MEANINGS).filter((name) => settings.has(name)), ...[...settings.keys()].filter((name) => !MEANINGS[name])].map((name) => settingFact([name, settings.get(name)])))),
    card("Open proposals", h("p", { class: "quiet" }, `A majority is ${number(Math.floor(organisations.length / 2) + 1)} of ${plural(organisations.length, "organisation", "organisations")}.`), table("Open proposals", ["proposal", "what", "proposed by", "approved by", "lapses"], rows, "Nothing is proposed.")),
    card("Contracts that change", due.length ? h("p", {}, go("contracts", plural(due.length, "change waits", "changes wait"))) : h("p", {}, "No change of a contract waits.")));
}

/** Who stands for a proposal. */
function voices(entry) {
  const { approvals } = entry;
  return approvals instanceof Map ? [...approvals.keys()] : Array.isArray(approvals) ? approvals : [];
}

export async function proposalPage({ args: [id = ""] }) {
  const entry = /^[0-9a-f]{64}$/.test(id) ? objectOf(await api.view("membership", "proposal", new Bytes(id))) : null;
  if (!entry) return sheet("Proposal", "The last closed proposals are kept, older ones are not.", problemView({ detail: "There is no such proposal.", code: "NOT_FOUND" }));
  const { arguments: content, ...rest } = entry;
  return sheet("Proposal", "A proposal takes effect once a majority of the active organisations stands for it, and lapses otherwise.",
    card(null, facts([
      ["proposed in", go(`tx/${id}`, hex(id))],
      ["what", h("span", { class: "mono" }, `${entry.contract}: ${entry.kind}`)],
      ["state", badge(entry.status ?? "open")],
      ["approved by", voices(entry).join(", ") || "nobody yet"],
      entry.expires_ms && ["lapses", moment(entry.expires_ms)],
    ])),
    card("What it would do", valueView(content ?? rest)));
}
