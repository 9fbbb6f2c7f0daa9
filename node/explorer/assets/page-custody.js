// Custody: what custodians reported on the chain: releases, refusals, erasures and what remains. Whose data it was, nobody sees.

import { h } from "./shared/dom.js";
import { plural } from "./shared/format.js";
import { api, objectOf } from "./api.js";
import { badge, card, facts, fullHex, go, hex, moment, number, problemView, sheet, table } from "./pieces.js";

const WINDOW_BLOCKS = 2_000;
const SHOWN_COUNT = 60;

export async function custodyPage({ args: [first] }) {
  const { head, earliest_height: earliest } = await api.status();
  const from = Math.max(earliest, /^\d+$/.test(first ?? "") ? Number(first) : head - WINDOW_BLOCKS + 1);
  const [names, erasures, accesses, records] = await Promise.all([custodianNames(), api.events({ from, contract: "erasure" }), api.events({ from, contract: "access" }), api.events({ from, contract: "records" })]);
  return sheet("Custody",
    "What robots recorded lies with custodians, as ciphertext. The chain holds a commitment to it, and what custodians did: what they released, what they refused, which keys they destroyed. A key on the chain stands for one visit; whose it was, the chain does not say.",
    cutOff([erasures, accesses, records]),
    card("In short", h("p", { class: "quiet" }, `Since block ${number(from)}:`), summary(erasures.events, accesses.events, records.events)),
    card("Erasures", h("p", { class: "quiet" }, "An erasure is complete once every custodian has destroyed its keys and said so."), table("Erasures, newest first", ["block", "what happened", "by", "more"], newest(erasures.events).map((event) => erasureRow(event, names)), "No erasure in these blocks.")),
    card("Releases and refusals", table("Access, newest first", ["block", "what happened", "by", "more"], newest(accesses.events).map((event) => accessRow(event, names)), "Nobody asked for records in these blocks.")),
    from > earliest && h("p", {}, go(`custody/${Math.max(earliest, from - 4 * WINDOW_BLOCKS)}`, "Look further back")));
}

/** Say so where there is more than was read: from the oldest on, so what is missing is newer. */
function cutOff(parts) {
  const cut = parts.filter((part) => !part.isAll).map((part) => part.upTo);
  if (!cut.length) return null;
  const upTo = Math.min(...cut);
  return h("p", { class: "notice warn" }, `More happened in these blocks than is read at once: of some of it you see nothing after block ${number(upTo)}. `, go(`custody/${upTo}`, "Go on from there"));
}

function newest(events) {
  return events.slice(-SHOWN_COUNT).reverse();
}

function summary(erasures, accesses, records) {
  const count = (events, name) => events.filter((event) => event.name === name).length;
  return h("ul", {}, [
    `${plural(count(records, "visit_opened"), "visit was", "visits were")} opened, ${plural(count(records, "recorded"), "record", "records")} made`,
    `${plural(count(accesses, "requested"), "request", "requests")} for records, ${plural(count(accesses, "released"), "release", "releases")}, ${plural(count(accesses, "refused"), "refusal", "refusals")}`,
    `${plural(count(erasures, "requested"), "erasure", "erasures")} asked for, ${plural(count(erasures, "receipted"), "receipt", "receipts")} of custodians, ${plural(count(erasures, "expired"), "report", "reports")} of records that expired`,
  ].map((text) => h("li", {}, text)));
}

/** The names of custodians by key, as the genesis file has them; one that joined later shows its key. */
async function custodianNames() {
  const genesis = await api.genesis().catch(() => ({ nodes: [] }));
  return new Map(genesis.nodes.filter((node) => node.custodian_key).map((node) => [node.custodian_key, node.name]));
}

function who(key, names) {
  return key ? (names.get(key.hex) ?? hex(key.hex)) : "";
}

function erasureRow(event, names) {
  const { data } = event;
  const place = go(`block/${event.height}`, number(event.height));
  if (event.name === "requested") return [place, badge("erasure asked for", "warn"), go(`tx/${event.txid}`, "owner's transaction"), go(`erasure/${data.erasure_id.hex}`, data.records.length ? `${plural(data.records.length, "record", "records")}${data.frames.length ? ", some frames" : ""}` : "a whole visit")];
  if (event.name === "receipted") return [place, data.status === "complete" ? badge("receipt; complete", "good") : badge("receipt"), who(data.custodian, names), go(`erasure/${data.erasure_id.hex}`, "all receipts")];
  return [place, badge("expired"), who(data.custodian, names), plural(data.record_ids.length, "record was erased unasked", "records were erased unasked")];
}

function accessRow(event, names) {
  const { data } = event;
  const place = go(`block/${event.height}`, number(event.height));
  const transaction = go(`tx/${event.txid}`, "transaction");
  const words = {
    requested: [badge("asked for"), data.purpose ? `purpose ${data.purpose}` : ""],
    released: [badge("released", "good"), plural(data.records?.length ?? 0, "record", "records")],
    refused: [badge("refused", "bad"), data.code ?? data.reason ?? ""],
    verdict: [badge(data.verdict === "corrupted" ? "found corrupted" : "found whole", data.verdict === "corrupted" ? "bad" : "good"), "the owner's own check"],
    granted: [badge("shared"), "with a one-time key"],
    revoked: [badge("sharing ended"), ""],
    noticed: [badge("notice read"), ""],
  }[event.name] ?? [badge(event.name), ""];
  return [place, words[0], data.custodian ? who(data.custodian, names) : transaction, words[1]];
}

export async function erasurePage({ args: [id = ""] }) {
  const { Bytes } = await import("./msgpack.js");
  const found = /^[0-9a-f]{64}$/.test(id) ? objectOf(await api.view("erasure", "get", new Bytes(id))) : null;
  if (!found) return sheet("Erasure", "An erasure has the id of the transaction that asked for it.", problemView({ detail: "There is no such erasure.", code: "NOT_FOUND" }));
  const names = await custodianNames();
  const receipts = [...found.receipts];
  const open = found.custodians.filter((key) => !receipts.some(([told]) => told.hex === key.hex));
  return sheet("Erasure",
    "Each custodian destroys its keys to the records, so that what it stores opens no more, deletes them, reads back, and signs here what remains and until when.",
    card(null, facts([
      ["asked for in", go(`tx/${id}`, hex(id))],
      ["state", found.status === "complete" ? badge("complete", "good") : badge("under way", "warn"), open.length ? ["Still to come: ", open.map((key, index) => [index ? ", " : "", who(key, names)])] : null],
      ["what", found.records.length ? plural(found.records.length, "record", "records") : "a whole visit", found.frames.length ? `${plural(found.frames.length, "frame", "frames")} of it` : null],
    ])),
    card("Receipts", receipts.length ? receipts.map(([key, told]) => {
      const receipt = objectOf(told);
      return h("div", { class: "stack event" }, h("h3", {}, who(key, names)), facts([
        ["destroyed", plural(receipt.destroyed_frames, "frame's key", "frames' keys")],
        ["what remains", receipt.remains || "nothing", receipt.remains_until_ms ? ["until ", moment(receipt.remains_until_ms)] : null],
        ["said on", moment(receipt.time)],
        ["digest", fullHex(receipt.digest.hex), "Of what the custodian deleted, as it keeps it in its log."],
      ]));
    }) : h("p", {}, "No custodian has reported yet.")));
}

