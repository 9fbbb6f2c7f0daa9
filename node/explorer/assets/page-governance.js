// Settings and proposals: by which numbers the chain runs, and what organisations are deciding.

import { h } from "./shared/dom.js";
import { plural } from "./shared/format.js";
import { api, objectOf } from "./api.js";
import { Bytes } from "./msgpack.js";
import { badge, card, facts, go, hex, moment, number, problemView, sheet, table, valueView } from "./pieces.js";

const MEANINGS = {
  base_timeout_ms: "How long producers wait for a leader before they give its round up, at first.",
  timeout_cap_ms: "The wait grows while rounds go on failing, up to this.",
  heartbeat_ms: "After so long without work an empty block is made, so that silence means something.",
  min_block_interval_ms: "No two blocks are closer together.",
  max_clock_drift_ms: "How far ahead of a node's clock a block's time may be.",
  blocks_per_turn: "How many rounds one producer leads in a row.",
  production: "When blocks are made: on-demand, or at an interval.",
  max_producers: "How many seats there are at most.",
};

export async function governancePage() {
  const [settings, open, organisations, { due }] = await Promise.all([api.view("settings", "in_force"), api.view("membership", "proposals"), api.view("membership", "active_organisations"), api.contracts()]);
  const proposals = await Promise.all(open.map(async ([id, organisation, expiresMs]) => ({ id: id.hex, organisation, expiresMs, entry: objectOf(await api.view("membership", "proposal", id)) })));
  const rows = proposals.map((one) => [go(`proposal/${one.id}`, hex(one.id)), h("span", { class: "mono" }, `${one.entry.contract}: ${one.entry.kind}`), one.organisation, voices(one.entry).join(", "), moment(one.expiresMs)]);
  return sheet("Governance",
    `What holds for all is decided by the ${plural(organisations.length, "organisation", "organisations")} together: one proposes, and once a majority approves it takes effect. Settings change at the end of an epoch, in one block for all nodes.`,
    card("Settings in force", table("Settings", ["setting", "value", "what it is for"], [...settings].map(([name, value]) => [h("span", { class: "mono" }, name), String(value), MEANINGS[name] ?? ""]))),
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
