// Erasing: what will be gone and what remains, said before; the custodians' receipts as they come in, after.
// Must never call erased what a custodian has not confirmed.

import { announce, focusOn, h, replace } from "./shared/dom.js";
import { Problem } from "./shared/fetching.js";
import { follow, get, post, postWithPassphrase } from "./api.js";
import { clock, moment, problemCard, progressOf, redraw, sentences, tell, thingsOf } from "./pieces.js";
import { choose, chosen, drop } from "./selection.js";
import { said, t } from "./texts.js";

/** Show every erasure that was asked for, newest first, and who has confirmed it. */
export async function showErasing(context) {
  let data = await get("erasures", {}, context.signal);
  const node = h("div", {});
  const everything = () => {
    choose({ all: true, records: [], title: t("erase.everything"), back: "erasing" });
    context.go("erase");
  };
  const draw = () => replace(node, h("p", { class: "lead" }, t("erasing.lead")), data.erasures.length === 0 ? h("div", { class: "card" }, h("p", {}, t("erasing.empty"))) : [...data.erasures].reverse().map(card),
    context.overview.counts.records + context.overview.counts.notices > 0 && h("section", { class: "card" }, h("h2", {}, t("erase.everything")), h("p", {}, t("erase.everythingText")), h("button", { type: "button", class: "danger", "data-key": "all", onclick: everything }, t("erase.everythingButton"))));
  draw();
  return { title: t("erasing.title"), node, async refresh() {
    data = await get("erasures", {}, context.signal);
    redraw(node, draw);
  } };
}

function card(erasure) {
  const isDone = erasure.status === "complete";
  const what = erasure.frames.length ? t("erase.whatFrames", { count: erasure.frames.length }) : t("erase.what", { count: erasure.records });
  return h("section", { class: "card" }, h("div", { class: "row" }, h("h2", {}, what), h("span", { class: `badge ${isDone ? "good" : "warn"}` }, isDone ? t("erase.complete") : t("erase.waiting"))),
    h("p", { class: "quiet" }, t("erase.asked", { time: moment(erasure.asked_at_ms) })), receiptList(erasure.custodians));
}

/** The custodians' words, one line each. */
export function receiptList(custodians) {
  return h("ul", { class: "receipts" }, custodians.map((one) => {
    const tone = one.confirmed_at_ms ? "good" : one.overdue ? "bad" : "waiting";
    const words = one.confirmed_at_ms ? t("receipt.confirmed", { name: one.name, time: clock(one.confirmed_at_ms), count: one.destroyed_frames }) : t(one.overdue ? "receipt.overdue" : "receipt.waiting", { name: one.name });
    return h("li", { class: tone }, words, one.confirmed_at_ms && one.remains && one.remains !== "nothing" ? h("div", { class: "quiet" }, t("receipt.remains", { what: said(`receipt.${one.remains}`, one.remains), time: moment(one.remains_until_ms) })) : null);
  }));
}

/** The form: what goes, what stays, who had it; then the passphrase; then the receipts, live. */
export async function showEraseForm(context) {
  const selection = chosen();
  if (!selection) return showErasing(context);
  const wanted = selection.all ? { all: true } : { records: selection.records, ...(selection.frames ? { frames: selection.frames } : {}) };
  const plan = await post("erasures/plan", wanted, context.signal);
  const node = h("div", {});
  const result = h("div", {});
  const total = Object.values(plan.kinds).reduce((sum, count) => sum + count, 0);
  const things = thingsOf(plan.kinds);

  const form = h("div", {},
    h("section", { class: "card" }, h("h2", {}, t("erase.gone")), h("p", {}, h("strong", {}, selection.title)), sentences([total > 0 ? t("erase.gone1", { count: total, things }) : t("erase.goneNotes"), ...(plan.recipients.length > 0 ? [t(selection.frames ? "erase.gone2Part" : "erase.gone2")] : [])])),
    h("section", { class: "card" }, h("h2", {}, t("erase.remains")), sentences([t("erase.remains1"), t("erase.remains2"), t("erase.remains3")])),
    plan.recipients.length > 0 && h("section", { class: "card" }, h("h2", {}, t("erase.recipients")), sentences(plan.recipients.map((one) => t("erase.recipient", { who: one.who })))),
    plan.visits > 1 && h("div", { class: "notice warn" }, h("p", {}, t("erase.joined", { count: plan.visits }))),
    h("div", { class: "row" }, h("a", { class: "button", href: `#/${selection.back}` }, t("erase.keep")), h("button", { type: "button", class: "danger", onclick: () => erase() }, t("erase.button"))));

  const erase = async () => {
    try {
      const accepted = await postWithPassphrase("erasures", { records: plan.records, ...(selection.frames ? { frames: plan.frames } : {}) }, { title: t("erase.askTitle"), text: total > 0 ? t("erase.askText", { count: total, things }) : t("erase.askNotes"), confirm: t("erase.button"), danger: true });
      if (accepted === null) return;
      await watch(accepted.job);
    } catch (error) {
      if (error instanceof Problem) tell(result, problemCard(error));
    }
  };

  const watch = async (job) => {
    const progress = progressOf(t("erase.working"));
    const receipts = h("div", { role: "status" });
    form.hidden = true;
    replace(result, h("section", { class: "card" }, h("h2", { tabindex: -1 }, t("erase.receipts")), receipts, progress.node));
    focusOn(result.querySelector("h2"));
    let told = "";
    const done = await follow(job, (state) => {
      progress.show(state);
      const now = JSON.stringify(state.receipts ?? []);
      if (state.receipts?.length && now !== told) replace(receipts, receiptList(state.receipts));
      told = now;
    });
    drop();
    replace(result, h("section", { class: "card" }, h("h2", { tabindex: -1 }, t(done.complete ? "erase.done" : "erase.notYet")), !done.complete && h("p", {}, t("erase.later")), done.erasures.map((one) => receiptList(one.custodians)),
      done.recipients.length > 0 && [h("h3", {}, t("erase.recipients")), sentences(done.recipients.map((one) => t("erase.recipient", { who: one.who })))], h("p", {}, h("a", { href: "#/erasing" }, t("erase.seeAll")), " · ", h("a", { href: "#/" }, t("calendar.title")))));
    focusOn(result.querySelector("h2"));
    announce(t(done.complete ? "erase.done" : "erase.notYet"));
  };

  replace(node, form, result);
  return { title: t("erase.title"), back: { href: `#/${selection.back}`, label: selection.all ? t("erasing.title") : selection.backLabel ?? selection.title }, node };
}
