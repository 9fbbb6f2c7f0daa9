// The seal: green if what came is what the robot took, red if not, and what was checked against which block.
// Must never be green for what was not checked, nor name a cause that no check found.

import { h } from "./shared/dom.js";
import { shortHex } from "./shared/format.js";
import { clock, moment } from "./pieces.js";
import { t } from "./texts.js";

const isWritten = (seal) => Boolean(seal.verdict_height);

/** A seal for a clip's recordings. `seals` in their order; `onVerdict` writes the finding down, if given. */
export function makeSeal(seals, onVerdict) {
  const bad = seals.filter((seal) => seal.state !== "good");
  const isGood = bad.length === 0 && seals.length > 0;
  const newest = seals.reduce((best, seal) => (best === null || seal.proved_height > best.proved_height ? seal : best), null);
  const shown = seals.reduce((sum, seal) => sum + seal.frames_ok, 0);
  const erased = seals.reduce((sum, seal) => sum + seal.erased.length, 0);
  const changed = seals.reduce((sum, seal) => sum + seal.corrupted.length, 0);
  const damaged = seals.reduce((sum, seal) => sum + seal.damaged.length, 0); // by who keeps them; the others by the robot
  const uneven = bad.filter((seal) => seal.frames_counted !== seal.frames_committed);
  const title = titleOf(seals);
  return h("section", { class: `seal ${isGood ? "good" : "bad"}`, "aria-label": t("seal.label"), role: isGood ? "region" : "alert", "data-seal": isGood ? "good" : "bad" },
    h("div", { class: "seal-words" },
      h("h2", {}, title),
      isGood ? h("p", {}, shown === 0 ? t("seal.noteText") : t("seal.goodText", { count: shown })) : [
        damaged > 0 && h("p", {}, t("seal.badText", { count: damaged })),
        changed > damaged && h("p", {}, t("seal.otherText", { count: changed - damaged })),
        uneven.length > 0 && h("p", {}, t("seal.unevenText", { count: uneven.length, counted: uneven[0].frames_counted, committed: uneven[0].frames_committed })),
        shown > 0 && h("p", {}, t(changed > 0 ? "seal.badRest" : "seal.unevenRest", { count: shown })), h("p", {}, t("seal.badNext"))],
      erased > 0 && h("p", {}, t("seal.erased", { count: erased })),
      newest && h("p", {}, t("seal.against", { height: newest.proved_height, time: moment(newest.proved_time_ms), id: shortHex(newest.proved_block_id) })),
      bad.length > 0 && seals.length > 1 && h("ul", { class: "sentences" }, bad.map((seal) => h("li", {}, h("a", { href: `#/record/${seal.record_id}` }, shortHex(seal.record_id)), ": ", seal.sentence))),
      h("details", { open: !isGood && seals.length === 1 }, h("summary", {}, t("seal.details")), seals.slice(0, 80).map((seal) => tellOne(seal, seals.length > 1))),
      onVerdict && seals.some((seal) => !isWritten(seal)) && h("p", {}, h("button", { type: "button", onclick: onVerdict }, t("seal.write")), h("span", { class: "quiet" }, " ", t("seal.writeWhy"))),
      seals.some(isWritten) && h("p", { class: "quiet" }, t("seal.written", { height: Math.max(...seals.map((seal) => seal.verdict_height ?? 0)) }))));
}

/** What the seal says in a word: good only if every check of every recording is. */
export function titleOf(seals) {
  const bad = seals.filter((seal) => seal.state !== "good");
  if (bad.length === 0 && seals.length > 0) return t("seal.good");
  return t(bad.some((seal) => seal.damaged.length > 0) || bad.length === 0 ? "seal.bad" : "seal.uneven");
}

function tellOne(seal, isNamed) {
  return h("div", { class: "seal-one" },
    isNamed && h("h3", {}, t("seal.of", { id: shortHex(seal.record_id) })),
    h("ul", { class: "checks" }, seal.checks.map((check) => h("li", { class: check.ok ? "ok" : "failed" }, h("span", { class: "visually-hidden" }, check.ok ? t("seal.ok") : t("seal.failed")), check.sentence))),
    (seal.refused ?? []).length > 0 && h("ul", { class: "sentences" }, seal.refused.map((one) => h("li", {}, t("seal.refused", { name: one.name }), " ", one.sentence))),
    h("dl", { class: "facts" }, h("dt", {}, t("seal.recordedAt")), h("dd", {}, t("seal.block", { height: seal.record_height })), h("dt", {}, t("seal.transaction")), h("dd", { class: "mono" }, shortHex(seal.record_txid)),
      h("dt", {}, t("seal.block1")), h("dd", { class: "mono" }, `${seal.proved_height} · ${shortHex(seal.proved_block_id)}`), h("dt", {}, t("seal.from")), h("dd", {}, seal.custodians.join(", ") || "–"), h("dt", {}, t("seal.checkedAt")), h("dd", {}, clock(seal.checked_at_ms))));
}

/** What stands in the seal's place if nothing could be checked: why, and what to do next. `row` as in `unsealed`, or null. */
export function uncheckedSeal(error, row) {
  const earlier = row && row.verdict !== null && t(`seal.earlier.${row.verdict}`, { time: moment(row.verdict_at_ms) });
  return h("section", { class: "seal", "aria-label": t("seal.label"), role: "alert", "data-seal": "unchecked" }, h("div", { class: "seal-words" },
    h("h2", {}, t("seal.unchecked")), h("p", {}, error.detail ?? t("problem.unexpected")), (error.nextStep || error.next_step) && h("p", {}, error.nextStep || error.next_step),
    earlier && h("p", { class: "quiet" }, earlier)));
}

/** What stands in the seal's place before anything was looked at. */
export function unsealed(row) {
  if (row.verdict === null) return h("section", { class: "seal", "aria-label": t("seal.label"), "data-seal": "none" }, h("div", { class: "seal-words" }, h("h2", {}, t("seal.none")), h("p", {}, t("seal.noneText"))));
  const tone = row.verdict === "verified" ? "good" : "bad";
  return h("section", { class: `seal ${tone}`, "aria-label": t("seal.label"), "data-seal": "earlier" }, h("div", { class: "seal-words" }, h("h2", {}, t(`seal.earlier.${row.verdict}`, { time: moment(row.verdict_at_ms) })), h("p", {}, t("seal.earlierText"))));
}
