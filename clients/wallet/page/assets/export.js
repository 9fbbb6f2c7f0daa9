// Taking everything along: one file with pictures, what is known of them, and proofs. Must never leave it in the page.

import { announce, focusOn, h, replace } from "./shared/dom.js";
import { Problem } from "./shared/fetching.js";
import { formatBytes } from "./shared/format.js";
import { follow, forget, getBytes, post, postWithPassphrase } from "./api.js";
import { dateOf, moment, problemCard, progressOf, sentences, tell } from "./pieces.js";
import { chosen, drop } from "./selection.js";
import { t } from "./texts.js";

/** The form, its warning, the progress, and the file. */
export async function showExport(context) {
  const selection = chosen()?.all ? null : chosen();
  const result = h("div", {});
  const from = h("input", { id: "export-from", type: "date" });
  const until = h("input", { id: "export-until", type: "date" });
  const pictures = h("input", { type: "checkbox", checked: true });
  const identity = h("input", { type: "checkbox", checked: true });
  let exported = null;
  let address = null;
  context.onLeave(() => {
    if (address) URL.revokeObjectURL(address);
    if (exported) forget(`exports/${exported}`);
    drop();
  });

  const body = () => ({
    records: selection?.records,
    from_ms: from.value ? dateOf(from.value).getTime() : 0,
    until_ms: until.value ? dateOf(until.value, 1).getTime() : 0,
    pictures: pictures.checked,
    identity: identity.checked,
  });

  const form = h("form", { class: "card", onsubmit: async (event) => {
    event.preventDefault();
    const wanted = body();
    try {
      const plan = await post("exports/plan", wanted, context.signal);
      replace(result, h("section", { class: "card" }, h("h2", { tabindex: -1 }, t("export.means")), h("p", {}, t("export.plan", { count: plan.records })), h("p", {}, t("export.learns")), sentences(given(plan, wanted)), h("p", {}, t("export.keep")), plan.records > 0 && h("button", { type: "button", class: "primary", onclick: () => start(wanted) }, t("export.start"))));
      focusOn(result.querySelector("h2"));
    } catch (error) {
      if (error.name !== "AbortError") replace(result, problemCard(error));
    }
  } },
  selection ? h("p", {}, h("strong", {}, selection.title)) : h("div", { class: "row" }, h("div", { class: "field" }, h("label", { for: "export-from" }, t("export.from")), from), h("div", { class: "field" }, h("label", { for: "export-until" }, t("export.until")), until)),
  h("div", { class: "field" }, h("label", { class: "switch" }, pictures, t("export.pictures"))), h("div", { class: "field" }, h("label", { class: "switch" }, identity, t("export.identity"))),
  h("button", { type: "submit", class: "primary" }, t("export.look")));

  const start = async (wanted) => {
    try {
      const accepted = await postWithPassphrase("exports", wanted, { title: t("export.askTitle"), text: t("export.askText"), confirm: t("export.start") });
      if (accepted === null) return;
      const progress = progressOf(t("export.working"));
      form.hidden = true;
      replace(result, progress.node);
      const done = await follow(accepted.job, progress.show, context.signal);
      exported = done.export;
      showDone(done);
    } catch (error) {
      form.hidden = false;
      if (error instanceof Problem) tell(result, problemCard(error));
    }
  };

  const showDone = (done) => {
    const save = h("button", { type: "button", class: "primary", onclick: async () => {
      if (!address) address = URL.createObjectURL(new Blob([(await getBytes(`exports/${done.export}/file`, {}, context.signal)).bytes], { type: "application/zip" }));
      h("a", { href: address, download: done.name }).click();
    } }, t("export.save", { name: done.name, size: formatBytes(done.bytes) }));
    replace(result, h("section", { class: "card" }, h("h2", { tabindex: -1 }, t(done.is_complete ? "export.done" : "export.partly")), h("p", {}, t("export.has", { count: done.pictures, records: t("export.what", { count: done.records }), height: done.proved_until_height })),
      done.problems.length > 0 && sentences(done.problems.map((one) => one.sentence)), h("p", {}, save), h("p", { class: "quiet" }, t("export.check")), h("pre", { tabindex: 0, role: "region", "aria-label": t("export.check") }, h("code", {}, done.check))));
    focusOn(result.querySelector("h2"));
    announce(t("export.done"));
  };

  const guardians = h("section", { class: "card", "aria-labelledby": "guardians" }, h("h2", { id: "guardians" }, t("guardians.title")), h("p", { class: "quiet" }, t("guardians.lead")), sentences(context.overview.guardians.map((line) => (line.at_ms === null ? line.sentence : `${moment(line.at_ms)}: ${line.sentence}`))));
  return { title: t("export.title"), node: h("div", {}, h("p", { class: "lead" }, t("export.lead")), form, result, guardians) };
}

/** What whoever has the file learns from it, as `blockrobot wallet export` says it. */
function given(plan, wanted) {
  const has = plan.records > 0;
  return [
    plan.visits > 0 && t("export.joined", { count: plan.visits }), wanted.pictures && has && t("export.seen"), wanted.identity && t("export.member"),
    t("export.noKey"), wanted.pictures && plan.visits > 1 && t("export.asked"),
  ].filter(Boolean);
}
