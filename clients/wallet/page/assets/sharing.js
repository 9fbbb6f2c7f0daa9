// Sharing: what is shared with whom, who looked, and the form for more. Must never share before it said what that means.

import { announce, ask, focusOn, h, replace } from "./shared/dom.js";
import { Problem } from "./shared/fetching.js";
import { follow, get, post, postWithPassphrase } from "./api.js";
import { moment, problemCard, progressOf, purposeName, redraw, sentences, tell } from "./pieces.js";
import { chosen, drop } from "./selection.js";
import { t } from "./texts.js";

const DAY_MS = 86_400_000;
const SPANS = [1, 7, 30];
const OWN_PURPOSES = ["own-access", "complaint"];
const WITH_MAX_CHARS = 200;
const NAME_MAX_CHARS = 100;
const HANDLE = /^([0-9a-f]{64}|brh1[0-9a-z]+)$/i;

/** Show what is shared, newest first. */
export async function showSharing(context) {
  let data = await get("shares", {}, context.signal);
  const node = h("div", {});
  const said = h("div", { role: "status" });

  const draw = () => replace(node, h("p", { class: "lead" }, t("sharing.lead")), said, data.shares.length === 0 ? h("div", { class: "card" }, h("p", {}, t("sharing.empty")), h("p", { class: "quiet" }, t("sharing.emptyNext"))) : [...data.shares].reverse().map(card));

  const card = (share) => h("section", { class: "card", "aria-labelledby": `share-${share.grant_id}` },
    h("div", { class: "row" }, h("h2", { id: `share-${share.grant_id}` }, share.name ?? share.who), h("span", { class: `badge ${share.status === "open" ? "accent" : ""}` }, t(`share.status.${share.status}`))),
    h("p", {}, t("share.what", { count: share.records.length }), " ", t("share.for", { purpose: purposeName(share.purpose, share.purpose_sentence) }), " ", t(`share.until.${share.status}`, { until: moment(share.until_ms) })),
    share.looks.length === 0 ? h("p", { class: "quiet" }, t("share.noLooks")) : sentences(share.looks.map((look) => t("share.look", { time: moment(look.time_ms), count: look.records }))),
    share.erased.length > 0 && h("p", {}, t("share.erased", { count: share.erased.length })),
    share.cut.length > 0 && h("p", {}, t("share.cut", { count: share.cut.length })),
    share.confirmed_deleted.length > 0 && h("p", {}, t("share.deleted", { count: share.confirmed_deleted.length })),
    share.status === "open" && h("p", {}, h("button", { type: "button", "data-key": `end-${share.grant_id}`, onclick: () => revoke(share) }, t("share.end"))));

  const revoke = async (share) => {
    const answer = await ask({ title: t("share.endTitle"), body: [h("p", {}, t("share.endText", { who: share.name ?? share.who }))], confirm: t("share.end"), cancel: t("ask.cancel"), danger: true });
    if (answer === null) return;
    const progress = progressOf(t("share.ending"));
    replace(said, progress.node);
    try {
      const { job } = await post(`shares/${share.grant_id}/revoke`);
      const result = await follow(job, progress.show);
      replace(said, h("div", { class: "notice good" }, h("p", {}, t("share.ended"), result.looks > 0 && ` ${t("share.endedLooked")}`)));
      announce(t("share.ended"));
      data = await get("shares", {}, context.signal);
      redraw(node, draw);
    } catch (error) {
      replace(said, problemCard(error));
    }
  };

  draw();
  return { title: t("sharing.title"), node, async refresh() {
    data = await get("shares", {}, context.signal);
    redraw(node, draw);
  } };
}

/** The form: with whom, what for, until when; then what it means; then the passphrase. */
export async function showShareForm(context) {
  const selection = chosen();
  if (!selection) return showSharing(context);
  const { people } = await get("shares", {}, context.signal);
  const purposes = Object.entries(context.overview.network.purposes).filter(([code]) => !OWN_PURPOSES.includes(code));
  const result = h("div", { role: "status" });
  const who = h("input", { id: "share-with", required: true, list: "share-people", "aria-describedby": "share-with-hint", autocomplete: "off", spellcheck: "false", maxlength: WITH_MAX_CHARS });
  const name = h("input", { id: "share-name", autocomplete: "off", maxlength: NAME_MAX_CHARS });
  const purpose = h("select", { id: "share-purpose" }, purposes.map(([code, sentence]) => h("option", { value: code }, purposeName(code, sentence))));
  const span = h("select", { id: "share-span" }, SPANS.map((days) => h("option", { value: days }, t("share.days", { count: days }))), h("option", { value: "date" }, t("share.date")));
  const date = h("input", { id: "share-date", type: "date", min: new Date(Date.now() + DAY_MS).toISOString().slice(0, 10) });
  span.value = "7";
  const dateField = field("share-date", t("share.untilDate"), date);
  dateField.hidden = true;
  span.addEventListener("change", () => { dateField.hidden = span.value !== "date"; });

  const body = () => ({ records: selection.records, with: who.value.trim(), name: name.value.trim() || undefined, purpose: purpose.value, until_ms: span.value === "date" ? new Date(`${date.value}T23:59:00`).getTime() : Date.now() + Number(span.value) * DAY_MS });
  const form = h("form", { class: "card", onsubmit: async (event) => {
    event.preventDefault();
    const wanted = body();
    try {
      const plan = await post("shares/plan", wanted, context.signal);
      replace(result, h("section", { class: "card" }, h("h2", { tabindex: -1 }, t("share.means")), h("p", {}, t("share.grantee", { name: plan.grantee.name || t("share.nobody"), role: t(`role.${plan.grantee.role}`), organisation: plan.grantee.organisation }), " ", t("share.what", { count: plan.records }), " ", t("share.until.open", { until: moment(plan.until_ms) })),
        sentences([t("share.sees"), t("share.listed"), t("share.canEnd"), t("share.undo")]), h("button", { type: "button", class: "primary", onclick: () => share(wanted) }, t("share.confirm"))));
      focusOn(result.querySelector("h2"));
    } catch (error) {
      if (error.name !== "AbortError") replace(result, problemCard(inPlainWords(error, wanted, people)));
    }
  } },
  h("p", {}, h("strong", {}, selection.title), !selection.backLabel && ` · ${t("share.what", { count: selection.records.length })}`),
  h("div", { class: "field" }, h("label", { for: "share-with" }, t("share.with")), who, h("div", { class: "quiet", id: "share-with-hint" }, t("share.withHint")), h("datalist", { id: "share-people" }, people.map((one) => h("option", { value: one.name || one.handle })))),
  field("share-name", t("share.name"), name), field("share-purpose", t("share.purpose"), purpose), field("share-span", t("share.span"), span), dateField,
  h("button", { type: "submit", class: "primary" }, t("share.plan")));

  const share = async (wanted) => {
    try {
      const accepted = await postWithPassphrase("shares", wanted, { title: t("share.askTitle"), text: t("share.askText"), confirm: t("share.confirm") });
      if (accepted === null) return;
      const progress = progressOf(t("share.working"));
      form.hidden = true;
      replace(result, progress.node);
      const done = await follow(accepted.job, progress.show);
      drop();
      const words = t("share.done", { count: done.shared.reduce((sum, one) => sum + one.records.length, 0) });
      const away = [...new Set(done.shared.flatMap((one) => one.custodians_away))];
      tell(result, h("div", { class: "notice good" }, h("p", {}, h("strong", {}, words)), done.shared.some((one) => one.left_out.length > 0) && h("p", {}, t("share.leftOut")), away.length > 0 && h("p", {}, t("share.away", { names: away.join(", ") })), h("p", {}, h("a", { href: "#/sharing" }, t("share.seeAll")))));
      announce(words);
    } catch (error) {
      form.hidden = false;
      if (error instanceof Problem) tell(result, problemCard(error));
    }
  };

  return { title: t("share.title"), back: { href: `#/${selection.back}`, label: selection.backLabel ?? selection.title }, node: h("div", {}, form, result) };
}

/** Say what was wrong with whom they named as somebody at a page can mend it: no command, no option of one. */
function inPlainWords(error, wanted, people) {
  if (!["SHARE_NOT_POSSIBLE", "SHARE_WITH_NON_MEMBER", "HANDLE_MISTYPED"].includes(error.code)) return error;
  const isKnown = (name) => people.some((one) => one.name?.toLowerCase() === name?.toLowerCase());
  const isHandle = HANDLE.test(wanted.with.replace(/[\s-]/g, ""));
  if (error.code === "SHARE_NOT_POSSIBLE" && !isHandle && !isKnown(wanted.with)) return { detail: t("share.noHandle", { wanted: wanted.with }), nextStep: t("share.readAgain") };
  if (error.code === "SHARE_NOT_POSSIBLE" && wanted.name && isKnown(wanted.name) && isHandle) return { detail: t("share.nameTaken", { name: wanted.name }), nextStep: t("share.otherName") };
  return { detail: error.detail, nextStep: t(error.code === "SHARE_WITH_NON_MEMBER" ? "share.onlyStaff" : "share.readAgain") };
}

function field(id, label, input) {
  return h("div", { class: "field" }, h("label", { for: id }, label), input);
}
