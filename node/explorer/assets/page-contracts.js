// Contracts: what there is, and one of them with versions, interface, what calls cost, and source. Must never run one.

import { h } from "./shared/dom.js";
import { formatBytes } from "./shared/format.js";
import { api, readTransactions } from "./api.js";
import { feed } from "./feed.js";
import { badge, card, facts, fullHex, go, hex, moment, number, sheet, table } from "./pieces.js";

const KINDS = { activate: "goes into force", disable: "is disabled", keep: "is kept for good", return: "goes back" };
const LOOKED_AT_BLOCKS = 40;
const TONES = { active: "good", failed: "bad", disabled: "warn" };

export async function contractsPage() {
  const { contracts, due } = await api.contracts();
  return sheet("Contracts",
    "Contracts are programs that every node runs alike; they hold all that the network knows. Organisations decide together which version is in force. The source stands on the chain, so everybody can read by which rules they are treated.",
    card(null, table("All contracts", ["name", ["version", "number"], "state", ["since block", "number"], ["versions so far", "number"], "hash of the source"],
      contracts.map((one) => [go(`contract/${one.name}`, one.name), number(one.version), one.enabled ? badge("answers", "good") : badge("disabled", "warn"), number(one.since_height), number(one.versions), hex(one.source_hash)]))),
    card("Changes that wait", due.length ? h("ul", {}, due.map((change) => h("li", {}, go(`contract/${change.name}/${change.version}`, `${change.name} version ${change.version}`), ` ${KINDS[change.kind] ?? change.kind} `, change.from_height ? `with block ${number(change.from_height)}` : ["on ", moment(change.from_ms)])))
      : h("p", {}, "No contract is about to change.")));
}

export async function contractPage({ args: [name = "", version = "0", line = ""] }) {
  const one = await api.contract(name, Number(version) || 0);
  const all = (await api.contracts()).contracts.find((known) => known.name === name);
  const versions = Array.from({ length: all?.versions ?? 1 }, (_, index) => index + 1);
  return sheet(one.name,
    "An export is called by a transaction and may change the state; a view only reads. In the source below, the sentence under each entry says who may call it.",
    card("Version", facts([
      ["version", [`${one.version} `, badge(one.status, TONES[one.status] ?? "")], one.failure || null],
      versions.length > 1 && ["all versions", h("span", { class: "row" }, versions.map((number_) => go(`contract/${name}/${number_}`, String(number_))))],
      ["since block", go(`block/${one.since_height}`, number(one.since_height))],
      ["proposed by", one.organisation || "the genesis file", one.note || null],
      ["size", formatBytes(one.size_bytes), one.migrates ? "It carries the state of the version before over." : null],
      ["hash of the source", fullHex(one.source_hash), "What organisations approve is this hash."],
    ])),
    card("Interface", table("Entries", ["kind", "entry", "returns"], one.abi.map((entry) => [badge(entry.kind, entry.kind === "export" ? "accent" : ""), signature(entry), h("span", { class: "mono" }, entry.returns || "nothing")]))),
    await gasCard(name),
    card("Source", sourceView(one.source, Number(line))));
}

function signature(entry) {
  const parameters = entry.parameters.map((one, index) => `${one.name}: ${one.type}${index >= entry.required ? " = …" : ""}`);
  return h("span", { class: "mono wrap" }, `${entry.name}(${parameters.join(", ")})`);
}

/** What calls of the contract cost in the newest blocks that this page has; nothing if there were none. */
async function gasCard(name) {
  const heights = feed.headers.filter((header) => header.transaction_count > 0).slice(-LOOKED_AT_BLOCKS).map((header) => header.height);
  const blocks = await Promise.all(heights.map((height) => api.block(height).catch(() => null)));
  const entries = new Map();
  for (const block of blocks.filter(Boolean)) {
    for (const one of readTransactions(block)) {
      if (one.contract !== name) continue;
      const known = entries.get(one.entry) ?? { calls: 0, refused: 0, gas: 0, most: 0 };
      known.calls += 1;
      known.refused += one.receipt.ok ? 0 : 1;
      known.gas += one.receipt.gas_used;
      known.most = Math.max(known.most, one.receipt.gas_used);
      entries.set(one.entry, known);
    }
  }
  const rows = [...entries].sort().map(([entry, known]) => [h("span", { class: "mono" }, entry), number(known.calls), number(known.refused), number(Math.round(known.gas / known.calls)), number(known.most)]);
  return card("What calls cost", rows.length ? h("p", { class: "quiet" }, `Gas is the machine's measure of work. Counted in the newest ${blocks.length} blocks with transactions.`) : null, table(`Calls in the newest ${blocks.length} blocks with transactions`, ["entry", ["calls", "number"], ["refused", "number"], ["gas, mean", "number"], ["gas, most", "number"]], rows, `No call of ${name} stands in the newest blocks.`));
}

const TOKENS = /("""[\s\S]*?"""|"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*')|(#[^\n]*)|(@\w+)|\b(def|return|if|elif|else|for|while|in|not|and|or|is|None|True|False|break|continue|pass|require|emit|call)\b/g;

/** The source with a number before each line; the line that the address names is marked. */
function sourceView(source, marked) {
  const list = h("ol", {});
  let current = newLine(list, 1, marked);
  let count = 1;
  const add = (text, kind) => {
    text.split("\n").forEach((part, index) => {
      if (index > 0) current = newLine(list, (count += 1), marked);
      if (part) current.append(h("span", kind ? { class: kind } : {}, part));
    });
  };
  let last = 0;
  for (const found of source.trimEnd().matchAll(TOKENS)) {
    add(source.slice(last, found.index), "");
    add(found[0], found[1] ? "string" : found[2] ? "comment" : found[3] ? "decorator" : "keyword");
    last = found.index + found[0].length;
  }
  add(source.trimEnd().slice(last), "");
  return h("div", { class: "source", tabindex: "0", role: "region", "aria-label": "Source with line numbers" }, list);
}

function newLine(list, index, marked) {
  const code = h("code", {});
  list.append(h("li", { class: index === marked ? "here" : "" }, code));
  return code;
}
